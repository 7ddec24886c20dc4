"""Keys by name, and what is drawn from a key."""

from __future__ import annotations

from zlib import crc32

import jax
import jax.numpy as jnp
import numpy as np


def named_key(key: jax.Array, name: str) -> jax.Array:
    """The key of what is called `name`: draws by one name do not move those by another."""
    return jax.random.fold_in(key, np.uint32(crc32(name.encode())))


def draw_one(key: jax.Array, among: jax.Array) -> jax.Array:
    """One of those for whom `among` (n, ...) bool is true, along the first axis: (...) int32; 0 if there is none."""
    return jnp.where(among, jax.random.uniform(key, among.shape), -1.0).argmax(axis=0).astype(jnp.int32)
