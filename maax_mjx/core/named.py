"""`Named`, which says what it has when it is asked for something else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")


class Named(dict[str, T]):
    """Things by name; a name that is not there is a `KeyError` that lists those that are.

    Args:
        what: what they are, as messages have it, such as "modules".
        things: by name.
    """

    def __init__(self, what: str, things: Mapping[str, T] | None = None):
        super().__init__(things or {})
        self.what = what

    def __missing__(self, name: object) -> T:
        raise KeyError(f"{self.what}: got {name!r}; takes one of {list(self)}")

    def __reduce__(self) -> tuple[type[Named[T]], tuple[str, dict[str, T]]]:
        return Named, (self.what, dict(self))
