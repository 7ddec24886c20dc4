"""Checks of arguments. Every message names the argument, what it got and what it takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def check_vector(
    name: str, value: Any, length: int, takes: str, low: float = -np.inf, high: float = np.inf
) -> np.ndarray:
    """Returns `length` finite numbers in [low, high] as an array; `takes` describes them in the message."""
    try:
        vector = np.asarray(value, float)
        # NumPy takes True for 1, which is seldom what was meant.
        is_number = not any(isinstance(x, bool | np.bool_) for x in np.asarray(value, object).flat)
    except (TypeError, ValueError):
        vector, is_number = np.zeros(0), False
    is_inside = np.isfinite(vector).all() and ((vector >= low) & (vector <= high)).all()
    if not is_number or vector.shape != (length,) or not is_inside:
        raise ValueError(f"{name}: got {value!r}; takes {takes}")
    return vector


def check_rgba(name: str, value: Any) -> np.ndarray:
    """Returns a colour with opacity, (4,) in [0, 1]."""
    return check_vector(name, value, 4, "four numbers in [0, 1]: red, green, blue and opacity", 0.0, 1.0)


def check_number(name: str, value: Any, takes: str, low: float = 0.0, *, above: bool = False) -> float:
    """Returns a finite number of at least `low`; `above` excludes `low` itself."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not is_number or not low <= value < np.inf or (above and value == low):
        raise ValueError(f"{name}: got {value!r}; takes {takes}")
    return float(value)


def check_choice(name: str, value: Any, choices: Sequence[str]) -> str:
    """Returns one of several words."""
    if value not in choices:
        raise ValueError(f"{name}: got {value!r}; takes one of {list(choices)}")
    return str(value)
