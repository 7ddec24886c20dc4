"""Drawing again what did not fit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import jax
import jax.numpy as jnp


class Drawn(Protocol):
    """Something drawn that says whether it is any good: `valid` () bool."""

    @property
    def valid(self) -> jax.Array: ...


T = TypeVar("T", bound=Drawn)


def redraw(draw: Callable[[jax.Array], T], tries: int, key: jax.Array) -> T:
    """Draws until what is drawn is valid, `tries` times at most; the last draw counts.

    Args:
        draw: from the number of the try () int32, which starts at 0, to a pytree with a field `valid`.
        tries: how many draws there can be.
        key: any key of the world, for batches of worlds are traced once where all that the loop carries is batched.
    """

    def again(carry: tuple[jax.Array, T]) -> jax.Array:
        attempt, drawn = carry
        return (attempt == 0) | (~drawn.valid & (attempt < tries))

    draw = jax.jit(draw)  # whose Python runs once, for its shapes and in the loop
    first = (jax.random.key_data(key).ravel()[0] & 0).astype(jnp.int32)
    nothing = jax.tree.map(lambda s: jnp.broadcast_to(first.astype(s.dtype), s.shape), jax.eval_shape(draw, first))
    return jax.lax.while_loop(again, lambda carry: (carry[0] + 1, draw(carry[0])), (first, nothing))[1]
