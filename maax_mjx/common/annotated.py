"""Values held against types with bounds, such as `Count`: the one check of arguments and of fields of configs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

LARGEST: dict[Any, float] = {int: 2**31 - 1, float: float(np.finfo(np.float32).max)}
"""Magnitude that the arrays of a world can hold, by type."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of the numbers in an `Annotated` type; a pair of numbers is (low, high) with low <= high.

    Attributes:
        low, high: smallest and largest number; infinity stands for the largest of 32 bits.
        above: whether `low` itself is excluded.
        takes: words for the allowed numbers in messages; "" describes the bounds.
    """

    low: float = -np.inf
    high: float = np.inf
    above: bool = False
    takes: str = ""

    def words(self, noun: str) -> str:
        """Returns a description of the allowed numbers."""
        if self.takes:
            return self.takes
        if self.high < np.inf:
            return f"a {noun} in {'(' if self.above else '['}{_digits(self.low)}, {_digits(self.high)}]"
        if self.low == -np.inf:
            return "a finite number" if noun == "number" else f"a {noun}"
        return f"a positive {noun}" if self.above and not self.low else f"a {noun} of at least {_digits(self.low)}"

    def allow(self, value: Any, kind: Any) -> bool:
        """Whether a number of a kind, int or float, is within the bounds; NaN never is."""
        low = -LARGEST[kind] if self.low == -np.inf else self.low
        high = LARGEST[kind] if self.high == np.inf else self.high
        return low <= value <= high and not (self.above and value == low)


def _digits(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"


@dataclass(frozen=True)
class OneOf:
    """The words that a text in an `Annotated` type may be.

    Attributes:
        choices: the words, or a function that returns them, for registries that users add to.
    """

    choices: Iterable[str] | Callable[[], Iterable[str]]

    @property
    def names(self) -> list[str]:
        """The words, sorted."""
        return sorted(self.choices() if callable(self.choices) else self.choices)


Rule = Bounds | OneOf | None

Count = Annotated[int, Bounds(0)]
PositiveCount = Annotated[int, Bounds(1)]
CountRange = Annotated[int | tuple[int, int], Bounds(0)]
PositiveCountRange = Annotated[int | tuple[int, int], Bounds(1)]
Positive = Annotated[float, Bounds(0, above=True)]
NonNegative = Annotated[float, Bounds(0)]
PositiveRange = Annotated[float | tuple[float, float], Bounds(0, above=True)]
NonNegativeRange = Annotated[float | tuple[float, float], Bounds(0)]
Fraction = Annotated[float, Bounds(0, 1)]
FractionRange = Annotated[float | tuple[float, float], Bounds(0, 1)]


def check_value(name: str, value: Any, kind: Any) -> Any:
    """Returns a value that its type allows.

    Args:
        name: name of the value in messages.
        value: the value.
        kind: a type as annotations have it: `Annotated` with `Bounds` or `OneOf`, unions, containers of types, classes.
            Pairs and lists may be tuples or lists. Forms that are not known here allow everything.

    Raises:
        ValueError: a wrong value; the message says what is allowed, with the nearest word first.
    """
    if _allows(kind, value):
        return value
    rules = _rules(kind)
    known = [name for rule in rules if isinstance(rule, OneOf) for name in rule.names]
    near = get_close_matches(value, known, n=2) if isinstance(value, str) else []
    hint = f"did you mean {' or '.join(map(repr, near))}? It " if near else ""
    open_ended = not any(isinstance(rule, Bounds) and rule.high < np.inf for rule in rules)
    size = ", no larger than 32 bits hold" if open_ended and _is_too_large(value) else ""
    raise ValueError(f"{name}: got {_shown(value)}; {hint}takes {', or '.join(_words(kind))}{size}")


def _shown(value: Any) -> str:
    """Returns the value's text, or its type where that is long, as of a state."""
    text = repr(value)
    return text if len(text) <= 200 else type(value).__name__


def check_fields(config: Any) -> None:
    """Refuses a dataclass whose fields have values that their annotations do not allow.

    Raises:
        ValueError: a wrong value; the message names the field.
    """
    for name, kind in field_kinds(type(config)).items():
        check_value(name, getattr(config, name), kind)


def field_kinds(config: type) -> dict[str, Any]:
    """Returns the types of a dataclass's fields by name.

    Raises:
        ValueError: an annotation of a name that its module does not have.
    """
    try:
        hints = _type_hints(config)
    except NameError as error:
        raise ValueError(
            f"config: got {config.__name__}, with an annotation that cannot be read ({error}); takes types that its "
            "module imports or defines"
        ) from None
    return {f.name: hints[f.name] for f in fields(config)}


@cache
def _type_hints(config: Any) -> dict[str, Any]:
    return get_type_hints(config, include_extras=True)


def _allows(kind: Any, value: Any, rule: Rule = None) -> bool:
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated:
        rules = [x for x in kind.__metadata__ if isinstance(x, Bounds | OneOf)]
        return _allows(args[0], value, rules[0] if rules else rule)
    if origin in (Union, UnionType):
        return any(_allows(arg, value, rule) for arg in args)
    if origin is Literal:
        return any(type(value) is type(arg) and value == arg for arg in args)
    if kind in (None, NoneType):
        return value is None
    if kind in (int, float):
        return is_number(value, kind) and (rule if isinstance(rule, Bounds) else Bounds()).allow(value, kind)
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind is str:
        return isinstance(value, str) and (not isinstance(rule, OneOf) or value in rule.names)
    if origin is tuple:
        return isinstance(value, tuple | list) and _allows_items(args, value, rule)
    if origin is Sequence or origin is list:
        return isinstance(value, tuple | list) and all(_allows(args[0], item, rule) for item in value)
    if origin is Mapping or origin is dict:
        key, item = args
        return isinstance(value, Mapping) and all(_allows(key, k) and _allows(item, value[k], rule) for k in value)
    if kind is Callable or origin is Callable:
        return callable(value)
    try:
        return isinstance(value, kind)
    except TypeError:  # Any, type variables, protocols: nothing that a value can be held against.
        return True


def _allows_items(kinds: tuple[Any, ...], value: Sequence[Any], rule: Rule) -> bool:
    """Whether the items of a tuple are allowed; a pair of numbers with bounds is (low, high)."""
    if kinds[1:] == (...,):
        return all(_allows(kinds[0], item, rule) for item in value)
    if len(kinds) != len(value) or not all(_allows(k, item, rule) for k, item in zip(kinds, value, strict=True)):
        return False
    return not _is_range(kinds, rule) or value[0] <= value[1]


def _is_range(kinds: tuple[Any, ...], rule: Rule) -> bool:
    return isinstance(rule, Bounds) and kinds in ((int, int), (float, float))


def is_number(value: Any, kind: type = float) -> bool:
    """Whether a value is a whole number (`kind=int`) or any real one."""
    kinds = (int, np.integer) if kind is int else (int, float, np.integer, np.floating)
    return isinstance(value, kinds) and not isinstance(value, bool)


def _is_too_large(value: Any) -> bool:
    """Whether it is a finite number, or has one, that 32 bits do not hold."""
    if isinstance(value, tuple | list):
        return any(_is_too_large(item) for item in value)
    return is_number(value) and LARGEST[int if is_number(value, int) else float] < abs(value) < np.inf


def _rules(kind: Any) -> list[Bounds | OneOf]:
    """Returns all bounds and choices in a type."""
    own = [x for x in getattr(kind, "__metadata__", ()) if isinstance(x, Bounds | OneOf)]
    inner = () if get_origin(kind) in (Callable, Literal) else get_args(kind)
    return own + [rule for arg in inner for rule in _rules(arg)]


def _words(kind: Any, rule: Rule = None) -> list[str]:
    """Returns descriptions of what a type allows, one for each alternative."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated:
        rules = [x for x in kind.__metadata__ if isinstance(x, Bounds | OneOf)]
        return _words(args[0], rules[0] if rules else rule)
    if origin in (Union, UnionType):
        # None last, whatever the order of the annotation.
        return [word for arg in sorted(args, key=lambda arg: arg is NoneType) for word in _words(arg, rule)]
    if origin is Literal:
        return [f"one of {list(args)}"]
    if kind in (int, float):
        return [(rule if isinstance(rule, Bounds) else Bounds()).words("whole number" if kind is int else "number")]
    if kind is str:
        return [f"one of {rule.names}" if isinstance(rule, OneOf) else "a text"]
    if origin is tuple and _is_range(args, rule):
        return ["(low, high) with low <= high"]
    if origin is tuple and args[1:] != (...,):
        return [f"{len(args)} {_words(args[0], rule)[0].removeprefix('a ')}s"]
    if origin in (tuple, Sequence, list):
        return [
            "a list of such names" if isinstance(rule, OneOf) else f"a list, each {' or '.join(_words(args[0], rule))}"
        ]
    if origin in (Mapping, dict):
        return [f"a dict from names to {' or '.join(_words(args[1], rule))}"]
    if kind is Callable or origin is Callable:
        return ["a function"]
    named = {None: "None", NoneType: "None", bool: "True or False"}
    return [named.get(kind) or f"a {getattr(kind, '__name__', kind)}"]
