"""Texts of values by which files tell them apart: the same in every process, not cut, without addresses."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass
from functools import partial
from typing import Any
from zlib import crc32

import jax
import numpy as np

from maax_mjx.common.recorded import ENGINE, Arguments, Recorded, text_of
from maax_mjx.core.env import Environment


def whole_text(value: Any) -> str:
    """Returns a text of a value, such as an argument of a wrapper.

    Arrays are told apart by their numbers, functions and classes by their names alone, and objects of other classes by
    their `repr` without addresses.
    """
    if isinstance(value, Environment) and value.made:
        return f"{value.made.name}({', '.join(_given(_fields(value.made.config)))})"
    if isinstance(value, Recorded):
        return constructed(value)
    if isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key):
        return f"key({whole_text(jax.random.key_data(value))})"
    if isinstance(value, np.ndarray) and value.dtype == object:
        return whole_text(value.tolist())
    if isinstance(value, np.ndarray | jax.Array) and value.ndim:
        array = np.ascontiguousarray(value)
        return f"{array.dtype}{list(array.shape)} #{crc32(array.tobytes()):08x}"
    if isinstance(value, np.generic | np.ndarray | jax.Array):
        return repr(np.asarray(value).item())
    if isinstance(value, partial):
        return f"partial({', '.join([whole_text(value.func), *_given(Arguments(value.args, value.keywords))])})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{whole_text(name)}: {whole_text(x)}' for name, x in value.items())}}}"
    if isinstance(value, set | frozenset):
        return f"{{{', '.join(sorted(map(whole_text, value)))}}}"
    if isinstance(value, list | tuple):
        return f"({', '.join(map(whole_text, value))})"
    if is_dataclass(value) and not isinstance(value, type):
        return f"{type(value).__name__}({', '.join(_given(_fields(value)))})"
    return text_of(value)


def constructed(made: Recorded) -> str:
    """Returns a text of an object with the arguments of its construction by name, but what it wraps and its engine."""
    given = made.made_with
    with suppress(TypeError, ValueError):  # an unusual signature
        given = Arguments((), _by_name(inspect.signature(type(made)).bind(*given.args, **given.kwargs)))
    wrapped = getattr(made, "given", made)
    return f"{type(made).__name__}({', '.join(_given(given, wrapped))})"


def _by_name(bound: inspect.BoundArguments) -> dict[str, Any]:
    """Arguments by their names, those of `**kwargs` among them."""
    found: dict[str, Any] = {}
    for name, value in bound.arguments.items():
        named = bound.signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD
        found |= value if named else {name: value}
    return found


def _given(given: Arguments, wrapped: Any = Ellipsis) -> list[str]:
    """Texts of arguments but what is wrapped and the engine."""
    named = {name: x for name, x in given.kwargs.items() if x is not wrapped and name != ENGINE}
    return [whole_text(x) for x in given.args if x is not wrapped] + [f"{n}={whole_text(x)}" for n, x in named.items()]


def _fields(config: Any) -> Arguments:
    return Arguments((), {f.name: getattr(config, f.name) for f in fields(config)})


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns values by name as JSON has them, functions and objects as texts."""
    return json.loads(json.dumps(dict(values), default=_plain))


def _plain(value: Any) -> Any:
    """Returns what JSON takes for a value: a dict of a config, a list of an array, else a text."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else whole_text(value)
