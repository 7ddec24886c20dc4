"""`NamedModules`, which says what it has when it is asked for something else."""

from __future__ import annotations

from maax_mjx.modules import Module


class NamedModules(dict[str, Module]):
    """Modules by name; a name that is not there is a `KeyError` that lists those that are."""

    def __missing__(self, name: object) -> Module:
        raise KeyError(f"modules: got {name!r}; takes one of {list(self)}")
