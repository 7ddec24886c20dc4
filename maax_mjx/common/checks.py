"""Checks of arguments. Every message names the argument, what it got and what it takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.annotated import Bounds, OneOf, check_value

FloatRange = float | tuple[float, float]
FloatPair = tuple[float, float]
LONG = 2**63 - 1
"""Largest whole number of 64 bits, for numbers that stay on the host."""


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a tracer, so that its value cannot be read."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def described(value: Any) -> str:
    """Returns a short text for a value: numbers and strings as they are, else the type, as a state's repr is long."""
    if isinstance(value, jax.core.Tracer):
        return "an array"
    return repr(value) if value is None or isinstance(value, str | int | float) else type(value).__name__


def is_real_array(value: Any) -> bool:
    """Whether it is an array, or a tracer of one, of real numbers or booleans."""
    dtype = getattr(value, "dtype", None)
    return dtype is not None and any(jnp.issubdtype(dtype, kind) for kind in (jnp.bool_, jnp.integer, jnp.floating))


def array_words(value: Any) -> str:
    """Returns a short text for what may be an array: its dtype and shape, else its type."""
    return f"{value.dtype}{list(jnp.shape(value))}" if hasattr(value, "dtype") else f"a {type(value).__name__}"


def check_count(name: str, value: Any, minimum: int = 0, maximum: float = np.inf) -> int:
    """Returns a whole number from `minimum` to `maximum`; infinity stands for the largest of 32 bits."""
    check_value(name, value, Annotated[int, Bounds(minimum, maximum)])
    return int(value)


def check_count_range(name: str, value: Any, minimum: int = 0, maximum: float = np.inf) -> tuple[int, int]:
    """Returns (low, high) of a whole number or a range with minimum <= low <= high <= maximum."""
    check_value(name, value, Annotated[int | tuple[int, int], Bounds(minimum, maximum)])
    low, high = pair_of(value)
    return int(low), int(high)


def check_bool(name: str, value: Any) -> bool:
    """Returns True or False."""
    check_value(name, value, bool)
    return bool(value)


def check_positive(name: str, value: Any, maximum: float = np.inf) -> float:
    """Returns a positive finite number, up to `maximum`."""
    check_value(name, value, Annotated[float, Bounds(0, maximum, above=True)])
    return float(value)


def check_range(name: str, value: Any, low: float = 0.0, high: float = np.inf, *, above: bool = False) -> FloatPair:
    """Returns (low, high) of a finite number in [low, high] or a range; `above` excludes the lower bound itself."""
    check_value(name, value, Annotated[FloatRange, Bounds(low, high, above)])
    pair = pair_of(value)
    return float(pair[0]), float(pair[1])


def check_fraction(name: str, value: Any) -> FloatPair:
    """Returns (low, high) of a share in [0, 1] or a range of shares."""
    return check_range(name, value, 0.0, 1.0)


def pair_of(value: Any) -> tuple[Any, Any]:
    """Splits a number or a range that was checked into (low, high)."""
    low, high = value if isinstance(value, tuple | list) else (value, value)
    return low, high


def suggestion(word: object, known: Iterable[str]) -> str:
    """Returns " (did you mean 'x'?)" for the known word that is nearest to another; empty where none is near."""
    near = get_close_matches(str(word), list(known), 1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def check_choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """Returns one of the choices; an error suggests the nearest."""
    check_value(name, value, Annotated[str, OneOf(sorted(choices))])
    return value


def _is_again(new: Any, old: Any) -> bool:
    """Whether a function is another one anew: a cell of a notebook that ran twice, a module that was reloaded."""
    names = [(getattr(fn, "__module__", None), getattr(fn, "__qualname__", "<lambda>")) for fn in (new, old)]
    return names[0] == names[1] and "<" not in names[0][1]


def check_new_name(name: object, taken: Iterable[str] | Mapping[str, Any], new: Any = None) -> str:
    """A name that nothing is registered by yet.

    Args:
        name: the name.
        taken: names, or the functions that are registered by them.
        new: the function to be registered, which may replace the one of which it is another run.

    Raises:
        ValueError: something else than a text that is not empty, or a name that is taken.
    """
    functions: Mapping[str, Any] = taken if isinstance(taken, Mapping) else {}
    others = sorted(one for one in taken if one != name or not _is_again(new, functions.get(one)))
    if not isinstance(name, str) or not name or name in others:
        raise ValueError(f"name: got {name!r}; takes a name that is not taken, as are {others}")
    return name


def check_path(name: str, value: Any, endings: Sequence[str]) -> Path:
    """Returns the path of a file to write, with one of the endings and in an existing folder."""
    takes = f"a file that ends in {' or '.join(endings)}, in an existing folder"
    if not isinstance(value, str | Path):
        raise ValueError(f"{name}: got {described(value)}; takes the name of {takes}")
    path = Path(value)
    if path.suffix.lower() not in endings:
        raise ValueError(f"{name}: got {str(path)!r}; takes {takes}")
    if path.is_dir():
        raise ValueError(f"{name}: got {str(path)!r}, which is a folder; takes {takes}")
    if not path.parent.is_dir():
        raise ValueError(f"{name}: got {str(path)!r}, and no folder {str(path.parent)!r} exists; takes {takes}")
    return path


def check_per_object(name: str, value: Callable | Sequence[Callable], n: int) -> list[Callable]:
    """Returns a list of `n` functions, one per object, from one function for all or such a list."""
    if not callable(value) and (not isinstance(value, Sequence) or isinstance(value, str)):
        such = ", such as maax.uniform_placement," if isinstance(value, str) else ","
        raise ValueError(f"{name}: got {value!r}; takes a function (layout, cells) -> weights{such} or a list of {n}")
    fns = [value] * n if callable(value) else list(value)
    if len(fns) != n:
        raise ValueError(f"{name}: got a list of {len(fns)}; takes one function, or a list of {n}, one per object")
    for fn in fns:
        if not callable(fn):
            raise ValueError(f"{name}: got {fn!r}; takes a function (layout, cells) -> weights")
        check_takes(name, fn, ("layout", "cells"), "weights")
    return fns


def check_takes(name: str, fn: Callable, takes: tuple[str, ...], gives: str) -> None:
    """Refuses a function that cannot be called with some arguments.

    Args:
        name: of the argument, for messages.
        fn: the function.
        takes: the names of what it is called with.
        gives: what it returns, in a word.

    Raises:
        ValueError: such a function.
    """
    try:
        inspect.signature(fn).bind(*takes)
    except TypeError as error:
        mine = getattr(fn, "__name__", type(fn).__name__)
        raise ValueError(
            f"{name}: got {mine}{inspect.signature(fn)}; takes a function ({', '.join(takes)}) -> {gives}: {error}"
        ) from None
    except ValueError:
        pass  # A builtin function, which has no signature.


def check_not_donated(states: Any) -> None:
    """Refuses states whose memory was given to an earlier step."""
    if any(isinstance(x, jax.Array) and not is_traced(x) and x.is_deleted() for x in jax.tree.leaves(states)):
        raise RuntimeError(
            "states: these were donated to an earlier Worlds.step and their memory is in use again; "
            "keep its result instead, or make Worlds(..., donate=False)"
        )


def check_key(name: str, key: Any) -> None:
    """Refuses anything but a typed PRNG key."""
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raw = hasattr(key, "dtype") and key.dtype == jnp.uint32
        got = f"an array of {key.dtype}" if hasattr(key, "dtype") else repr(key)
        wrapped = ", or of an old one jax.random.wrap_key_data(key)" if raw else ""
        raise ValueError(f"{name}: got {got}; takes a typed key, jax.random.key(seed){wrapped}")
    if key.ndim:
        raise ValueError(f"{name}: got {key.shape[0]} keys; takes one key (use jax.vmap for a batch)")
