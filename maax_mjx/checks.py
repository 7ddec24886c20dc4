"""Checks of what users pass in. Every message names the argument, what it got and what it takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

IntRange = int | tuple[int, int]


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a tracer, so that its value cannot be looked at."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def check_count(name: str, value: Any, minimum: int = 0) -> int:
    """A whole number of at least `minimum`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < minimum:
        raise ValueError(f"{name}: got {value!r}; takes a whole number of at least {minimum}")
    return int(value)


def check_count_range(name: str, value: Any, minimum: int = 0) -> tuple[int, int]:
    """A whole number, or (low, high) with minimum <= low <= high."""
    pair = value if isinstance(value, tuple | list) else (value, value)
    whole = len(pair) == 2 and all(isinstance(v, int | np.integer) and not isinstance(v, bool) for v in pair)
    if not whole or not minimum <= pair[0] <= pair[1]:
        raise ValueError(
            f"{name}: got {value!r}; takes a whole number of at least {minimum}, or (low, high) with low <= high"
        )
    return int(pair[0]), int(pair[1])


def check_positive(name: str, value: Any) -> float:
    """A positive finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 < value < float("inf"):
        raise ValueError(f"{name}: got {value!r}; takes a positive number")
    return float(value)


def check_fraction(name: str, value: Any) -> tuple[float, float]:
    """A share in [0, 1], or (low, high) with 0 <= low <= high <= 1."""
    pair = value if isinstance(value, tuple | list) else (value, value)
    numbers = len(pair) == 2 and all(isinstance(v, int | float | np.number) and not isinstance(v, bool) for v in pair)
    if not numbers or not 0 <= pair[0] <= pair[1] <= 1:
        raise ValueError(f"{name}: got {value!r}; takes a number in [0, 1], or (low, high) with low <= high")
    return float(pair[0]), float(pair[1])


def check_friction(name: str, value: Any) -> float | None:
    """A sliding friction that is not negative, or None for MuJoCo's default."""
    if value is not None and (not isinstance(value, int | float | np.number) or not 0 <= value < float("inf")):
        raise ValueError(f"{name}: got {value!r}; takes a number of at least 0, or None")
    return None if value is None else float(value)


def check_choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """One of some names; suggests the nearest."""
    choices = sorted(choices)
    if value not in choices:
        near = get_close_matches(str(value), choices, n=2)
        hint = f" (did you mean {' or '.join(map(repr, near))}?)" if near else ""
        raise ValueError(f"{name}: got {value!r}; takes one of {choices}{hint}")
    return value


def check_per_object(name: str, value: Callable | Sequence[Callable], n: int) -> list[Callable]:
    """One function for all of `n` objects, or a list with one for each."""
    if not callable(value) and (not isinstance(value, Sequence) or isinstance(value, str)):
        raise ValueError(f"{name}: got {value!r}; takes a function (layout, cells) -> weights, or a list of {n}")
    fns = [value] * n if callable(value) else list(value)
    if len(fns) != n:
        raise ValueError(f"{name}: got a list of {len(fns)}; takes one function, or a list of {n}, one per object")
    for fn in fns:
        if not callable(fn):
            raise ValueError(f"{name}: got {fn!r}; takes a function (layout, cells) -> weights")
    return fns


def check_not_donated(states: Any) -> None:
    """Refuses states whose memory was given to an earlier step."""
    if any(isinstance(x, jax.Array) and not is_traced(x) and x.is_deleted() for x in jax.tree.leaves(states)):
        raise RuntimeError(
            "states: these were donated to an earlier Worlds.step and their memory is in use again; "
            "keep its result instead, or make Worlds(..., donate=False)"
        )


def check_key(name: str, key: Any) -> None:
    """A typed PRNG key."""
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        got = f"an array of {key.dtype}" if hasattr(key, "dtype") else repr(key)
        raise ValueError(f"{name}: got {got}; takes a typed key, jax.random.key(seed)")
    if key.ndim:
        raise ValueError(f"{name}: got {key.shape[0]} keys; takes one key (use jax.vmap for a batch)")
