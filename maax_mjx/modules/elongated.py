"""Numbers and directions of the elongated boxes or sites of a world (OpenAI's rule)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_count_range
from maax_mjx.common.keys import draw_integer, named_key
from maax_mjx.common.params import DomainParams, Parameter

LONG, THIN = 3.3, 0.3
"""Factors of an elongated object's length and width: 1.65 x 0.15 m instead of 0.5 x 0.5 m."""


class Elongated:
    """The elongated ones among `n_max` objects: the first, and of these those along x first.

    Args:
        name: of the argument and of the parameter.
        count: how many there are, or (low, high), as far as a world has so many objects.
        n_max: how many objects there can be.

    Raises:
        ValueError: a negative or reversed count, or more than there are objects.
    """

    def __init__(self, name: str, count: int | tuple[int, int], n_max: int):
        self.name, self.n_max = name, n_max
        self.count = check_count_range(name, count)
        if self.count[1] > n_max:
            raise ValueError(f"{name}: got {count!r}; takes at most {n_max}, the number of objects")

    @property
    def possible(self) -> bool:
        """Whether there can be any."""
        return self.count[1] > 0

    @property
    def parameters(self) -> list[Parameter]:
        """Their number, where there can be any."""
        return [Parameter(self.name, self.count, (0, self.count[1]))] if self.possible else []

    def largest(self, extent: np.ndarray) -> np.ndarray:
        """(n_max, 3) the extents that take the most room, of objects whose square ones have `extent` (3,)."""
        slot = np.arange(self.n_max)[:, None]
        return extent * np.where(slot < self.count[1], (LONG, THIN, 1.0), 1.0)

    def draw(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        """(n_max, 3) factors of the extents: any number of the elongated lie along x, the others along y."""
        if not self.possible:
            return jnp.ones((self.n_max, 3))
        count_key, along_key = jax.random.split(named_key(key, "elongated"))
        low, high = params[self.name]
        high = jnp.minimum(high, wanted.sum())
        n_long = draw_integer(count_key, jnp.minimum(low, high), high)
        n_along_x = draw_integer(along_key, 0, n_long)
        slot = jnp.arange(self.n_max)[:, None]
        along_x, along_y = jnp.array([LONG, THIN, 1.0]), jnp.array([THIN, LONG, 1.0])
        return jnp.where(slot < n_along_x, along_x, jnp.where(slot < n_long, along_y, 1.0))
