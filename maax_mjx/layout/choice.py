"""Drawing one of those that are possible."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def choose(share: jax.Array, possible: jax.Array) -> jax.Array:
    """The index of one that is possible, all of them equally likely.

    How many follow that are not possible changes nothing, so that arrays may be padded to any maximum.

    Args:
        share: (...) uniform in [0, 1).
        possible: (..., n) bool.

    Returns:
        (...) int32; 0 where none is possible.
    """
    rank = jnp.cumsum(possible, axis=-1)
    drawn = jnp.floor(share * rank[..., -1]).astype(jnp.int32) + 1
    return (rank >= drawn[..., None]).argmax(axis=-1).astype(jnp.int32)
