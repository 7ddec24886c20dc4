"""Checks of arguments. Every message names the argument, what it got and what it takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

FloatRange = float | tuple[float, float]
FloatPair = tuple[float, float]


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a tracer, so that its value cannot be read."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def described(value: Any) -> str:
    """Returns a short text for a value: numbers and strings as they are, else the type, as a state's repr is long."""
    return repr(value) if value is None or isinstance(value, str | int | float) else type(value).__name__


def check_count(name: str, value: Any, minimum: int = 0) -> int:
    """Returns a whole number of at least `minimum`."""
    if not _is_number(value, int, np.integer) or value < minimum:
        raise ValueError(f"{name}: got {value!r}; takes a whole number of at least {minimum}")
    return int(value)


def check_count_range(name: str, value: Any, minimum: int = 0) -> tuple[int, int]:
    """Returns (low, high) of a whole number or a range with minimum <= low <= high."""
    low, high = _pair(value)
    if not _is_number(low, int, np.integer) or not _is_number(high, int, np.integer) or not minimum <= low <= high:
        raise ValueError(
            f"{name}: got {value!r}; takes a whole number of at least {minimum}, or (low, high) with low <= high"
        )
    return int(low), int(high)


def check_bool(name: str, value: Any) -> bool:
    """Returns True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: got {value!r}; takes True or False")
    return bool(value)


def check_positive(name: str, value: Any) -> float:
    """Returns a positive finite number."""
    if not _is_number(value) or not 0 < value < np.inf:
        raise ValueError(f"{name}: got {value!r}; takes a positive number")
    return float(value)


def check_range(name: str, value: Any, low: float = 0.0, high: float = np.inf, *, above: bool = False) -> FloatPair:
    """Returns (low, high) of a finite number in [low, high] or a range; `above` excludes the lower bound itself."""
    pair = _pair(value)
    inside = all(_is_number(v) and low <= v <= high and abs(v) < np.inf and not (above and v == low) for v in pair)
    if not inside or not pair[0] <= pair[1]:
        least = "a positive number" if above and low == 0 else f"a number of at least {low:g}"
        least = least if low > -np.inf else "a finite number"
        takes = least if high == np.inf else f"a number in [{low:g}, {high:g}]"
        raise ValueError(f"{name}: got {value!r}; takes {takes}, or (low, high) with low <= high")
    return float(pair[0]), float(pair[1])


def check_fraction(name: str, value: Any) -> FloatPair:
    """Returns (low, high) of a share in [0, 1] or a range of shares."""
    return check_range(name, value, 0.0, 1.0)


def _pair(value: Any) -> tuple[Any, Any]:
    """Splits an argument into (low, high); both None where it is a sequence of another length than two."""
    if not isinstance(value, tuple | list):
        return value, value
    return (value[0], value[1]) if len(value) == 2 else (None, None)


def _is_number(value: Any, *kinds: type) -> bool:
    return isinstance(value, kinds or (int, float, np.number)) and not isinstance(value, bool)


def check_choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """Returns one of the choices; an error suggests the nearest."""
    choices = sorted(choices)
    if value not in choices:
        near = get_close_matches(str(value), choices, n=2)
        hint = f" (did you mean {' or '.join(map(repr, near))}?)" if near else ""
        raise ValueError(f"{name}: got {value!r}; takes one of {choices}{hint}")
    return value


def check_new_name(name: object, taken: Iterable[str]) -> str:
    """A name that nothing is registered by yet.

    Raises:
        ValueError: something else than a text that is not empty, or a name that is taken.
    """
    taken = sorted(taken)
    if not isinstance(name, str) or not name or name in taken:
        raise ValueError(f"name: got {name!r}; takes a name that is not taken, as are {taken}")
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
    """Refuses anything but a typed PRNG key."""
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raw = hasattr(key, "dtype") and key.dtype == jnp.uint32
        got = f"an array of {key.dtype}" if hasattr(key, "dtype") else repr(key)
        wrapped = ", or of an old one jax.random.wrap_key_data(key)" if raw else ""
        raise ValueError(f"{name}: got {got}; takes a typed key, jax.random.key(seed){wrapped}")
    if key.ndim:
        raise ValueError(f"{name}: got {key.shape[0]} keys; takes one key (use jax.vmap for a batch)")
