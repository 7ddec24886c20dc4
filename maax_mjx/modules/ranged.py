"""A number that a module takes fixed, or as a range to draw from."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import FloatRange, check_range
from maax_mjx.common.keys import named_key
from maax_mjx.common.params import DomainParams, Parameter


class Ranged:
    """A fixed number, or a range that is a randomisation parameter.

    A fixed number is compiled into the model and costs nothing; a range makes worlds differ in it.

    Args:
        name: of the parameter.
        value: a number, or (low, high), which is also as far as params can move it.
        low, high: what it may be.
        above: whether `low` itself is left out.
        argument: what the value was passed as, if it is not called as the parameter is.

    Raises:
        ValueError: a value outside [low, high], or a reversed range.
    """

    def __init__(
        self,
        name: str,
        value: FloatRange,
        low: float = 0.0,
        high: float = np.inf,
        *,
        above: bool = False,
        argument: str | None = None,
    ) -> None:
        self.name = name
        self.low, self.high = check_range(argument or name, value, low, high, above=above)
        self.varies = isinstance(value, tuple | list)

    @property
    def parameters(self) -> list[Parameter]:
        """The parameter that a range is; none of a fixed number."""
        pair = (self.low, self.high)
        return [Parameter(self.name, pair, pair)] if self.varies else []

    def draw(self, key: jax.Array, params: DomainParams, n: int, *, shared: bool = False) -> jax.Array:
        """(n,) numbers, uniform over the parameter's range: each its own, or one for all of them.

        Drawn from a key of its own: what else a module draws does not move it.
        """
        if not self.varies:
            return jnp.full(n, self.low)
        key = named_key(key, self.name)
        low, high = params[self.name]
        share = jnp.broadcast_to(jax.random.uniform(key), (n,)) if shared else jax.random.uniform(key, (n,))
        return low + (high - low) * share
