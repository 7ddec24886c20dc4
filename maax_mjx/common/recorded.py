"""Objects that know the arguments they were made with."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, NamedTuple, Self

import numpy as np


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


def short(value: Any) -> str:
    """Returns a text for an argument: functions and classes by their names, without addresses, long texts cut."""
    text = getattr(value, "__qualname__", None) or re.sub(r" at 0x[0-9a-f]+", "", repr(value))
    return text if len(text) <= 60 else f"{text[:57]}..."


def differing(config: Any) -> dict[str, Any]:
    """Returns the fields of a dataclass that differ from their defaults, by name, inner ones by dotted name."""
    return _differences(config, type(config)(), "")


def _differences(config: Any, default: Any, where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for f in fields(config):
        value, usual = getattr(config, f.name), getattr(default, f.name)
        if _same(value, usual):
            continue
        if is_dataclass(value) and type(value) is type(usual):
            found |= _differences(value, usual, f"{where}{f.name}.")
        else:
            found[f"{where}{f.name}"] = value
    return found


def unchanged(config: Any) -> dict[str, Any]:
    """Returns the fields of a dataclass that have their defaults, by name, inner ones by dotted name."""
    return _unchanged(config, type(config)(), "")


def _unchanged(config: Any, default: Any, where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for f in fields(config):
        value, usual = getattr(config, f.name), getattr(default, f.name)
        if is_dataclass(value) and type(value) is type(usual):
            found |= _unchanged(value, usual, f"{where}{f.name}.")
        elif _same(value, usual):
            found[f"{where}{f.name}"] = value
    return found


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


def plain_config(config: dict[str, Any]) -> dict[str, Any]:
    """Returns fields of a config as JSON has them, with functions and objects as texts."""
    return json.loads(json.dumps(config, default=_plain))


def _plain(value: Any) -> Any:
    """Returns what JSON takes for a value: a dict of a config, numbers of NumPy, else a text."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else short(value)


def texts_of(config: Mapping[str, Any]) -> dict[str, str]:
    """Returns the fields of a plain config as texts, as the command line takes them, inner ones by dotted name."""
    fields: dict[str, str] = {}
    for name, value in config.items():
        inner = value if isinstance(value, dict) else {}
        fields |= {f"{name}.{part}": repr(x) for part, x in inner.items()} or {name: repr(value)}
    return {name: text for name, text in fields.items() if name != "impl"}
