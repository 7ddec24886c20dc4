"""Names that users give to what they register."""

from __future__ import annotations

from collections.abc import Iterable


def check_new_name(name: object, taken: Iterable[str]) -> str:
    """A name that nothing is registered by yet.

    Raises:
        ValueError: something else than a text that is not empty, or a name that is taken.
    """
    taken = sorted(taken)
    if not isinstance(name, str) or not name or name in taken:
        raise ValueError(f"name: got {name!r}; takes a name that is not taken, as are {taken}")
    return name
