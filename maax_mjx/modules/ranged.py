"""Numbers that are fixed, or a range to draw from."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import FloatRange, check_range
from maax_mjx.common.keys import named_key
from maax_mjx.common.params import DomainParams, Parameter


class Ranged:
    """A fixed number, or a range that is a randomisation parameter.

    A fixed number is compiled into the model and costs nothing; a range makes the number differ between worlds.

    Args:
        name: name of the parameter.
        value: a number, or (low, high), which is also the parameter's bound.
        low: smallest allowed value.
        high: largest allowed value.
        above: whether `low` itself is excluded.
        argument: name of the argument in messages, if it differs from the parameter's.

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
        """The parameter of a range; none for a fixed number."""
        pair = (self.low, self.high)
        return [Parameter(self.name, pair, pair)] if self.varies else []

    def draw(self, key: jax.Array, params: DomainParams, n: int, *, shared: bool = False) -> jax.Array:
        """Draws (n,) numbers, uniform over the parameter's range: one for each, or one for all.

        The draw has its own key, independent of the module's other draws.
        """
        if not self.varies:
            return jnp.full(n, self.low)
        key = named_key(key, self.name)
        low, high = params[self.name]
        share = jnp.broadcast_to(jax.random.uniform(key), (n,)) if shared else jax.random.uniform(key, (n,))
        return low + (high - low) * share
