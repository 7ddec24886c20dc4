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
    """The elongated objects among `n_max`: they come first, and those along x first among them.

    Args:
        name: name of the argument and of the parameter.
        count: number, or (low, high); at most as many as a world has objects.
        n_max: largest number of objects.

    Raises:
        ValueError: a negative or reversed count, or more than `n_max`.
    """

    def __init__(self, name: str, count: int | tuple[int, int], n_max: int):
        self.name, self.n_max = name, n_max
        self.count = check_count_range(name, count)
        if self.count[1] > n_max:
            raise ValueError(f"{name}: got {count!r}; takes at most {n_max}, the number of objects")

    @property
    def possible(self) -> bool:
        """Whether there can be any elongated objects."""
        return self.count[1] > 0

    @property
    def parameters(self) -> list[Parameter]:
        """The parameter of their number, if there can be any."""
        return [Parameter(self.name, self.count, (0, self.count[1]))] if self.possible else []

    def largest(self, extent: np.ndarray) -> np.ndarray:
        """Returns the extents (n_max, 3) that take the most room, where square objects have `extent` (3,)."""
        slot = np.arange(self.n_max)[:, None]
        return extent * np.where(slot < self.count[1], (LONG, THIN, 1.0), 1.0)

    def draw(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        """Draws factors (n_max, 3) of the extents: any number of the elongated lie along x, the others along y."""
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
