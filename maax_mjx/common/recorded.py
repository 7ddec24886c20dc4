"""Objects that know the arguments they were made with."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple, Self

import numpy as np

ENGINE = "impl"
"""The field of a config that says on which engine its game is stepped."""


class Arguments(NamedTuple):
    """The arguments of a call.

    Attributes:
        args: positional arguments.
        kwargs: arguments by name.
    """

    args: tuple[Any, ...]
    kwargs: dict[str, Any]

    @property
    def values(self) -> tuple[Any, ...]:
        """All arguments."""
        return *self.args, *self.kwargs.values()

    def map(self, function: Callable[[Any], Any]) -> Arguments:
        """Returns the arguments after a function of each."""
        return Arguments(tuple(map(function, self.args)), {name: function(x) for name, x in self.kwargs.items()})

    def __deepcopy__(self, memo: dict[int, Any]) -> Arguments:
        """Returns itself: copies of an object were made with the same arguments, which nobody changes."""
        return self

    def __str__(self) -> str:
        return ", ".join([*map(short, self.args), *(f"{name}={short(x)}" for name, x in self.kwargs.items())])


class Recorded:
    """Base class of objects that are told apart, and made again, by the arguments of their construction.

    Attributes:
        made_with: the arguments.
    """

    made_with: Arguments

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        new = super().__new__(cls)
        new.made_with = Arguments(args, kwargs)
        return new


def text_of(value: Any) -> str:
    """Returns a text for a value: functions and classes by their names, others by their `repr` without addresses."""
    return getattr(value, "__qualname__", None) or re.sub(r" at 0x[0-9a-f]+", "", repr(value))


def short(value: Any) -> str:
    """Returns `text_of` a value, cut if it is long."""
    text = text_of(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def differing(config: Any) -> dict[str, Any]:
    """Returns the fields of a dataclass that differ from their defaults, by name, inner ones by dotted name."""
    return {name: value for name, value, usual in _with_defaults(config, type(config)()) if not _same(value, usual)}


def unchanged(config: Any) -> dict[str, Any]:
    """Returns the fields of a dataclass that have their defaults, by name, inner ones by dotted name."""
    return {name: value for name, value, usual in _with_defaults(config, type(config)()) if _same(value, usual)}


def _with_defaults(config: Any, default: Any, where: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Names, values and defaults of the fields of a dataclass, and of those inside of its fields."""
    for f in fields(config):
        value, usual = getattr(config, f.name), getattr(default, f.name)
        if is_dataclass(value) and type(value) is type(usual):
            yield from _with_defaults(value, usual, f"{where}{f.name}.")
        else:
            yield f"{where}{f.name}", value, usual


def _same(value: Any, usual: Any) -> bool:
    """Whether two values of a field are equal, arrays among them."""
    if isinstance(value, np.ndarray) or isinstance(usual, np.ndarray):
        return type(value) is type(usual) and np.array_equal(value, usual)
    return value is usual or bool(value == usual)


def flat(config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the fields of a plain config by dotted name, with those of dicts in it, if these have any."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        inner = flat(value) if isinstance(value, Mapping) else {}
        found |= {f"{name}.{part}": x for part, x in inner.items()} or {name: value}
    return found


def texts_of(config: Mapping[str, Any]) -> dict[str, str]:
    """Returns the fields of a plain config as texts, as the command line takes them, without the engine."""
    return {name: repr(value) for name, value in flat(config).items() if name != ENGINE}
