"""Keys by name, and what is drawn from a key."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from zlib import crc32

import jax
import jax.numpy as jnp
import numpy as np


def named_key(key: jax.Array, name: str) -> jax.Array:
    """The key of what is called `name`: draws by one name do not move those by another."""
    return jax.random.fold_in(key, _number(name))


def named_keys(key: jax.Array, names: Iterable[str]) -> jax.Array:
    """(n,) `named_key` of every name: one program of threefry, which takes XLA a twelfth of a second to compile."""
    return jax.vmap(jax.random.fold_in, (None, 0))(key, np.array([_number(name) for name in names]))


def _number(name: str) -> np.uint32:
    return np.uint32(crc32(name.encode()))


def draw_integer(key: jax.Array, low: jax.Array | int, high: jax.Array | int) -> jax.Array:
    """A whole number, uniform from `low` to `high`: () int32. One draw, where `jax.random.randint` makes three."""
    n = (jax.random.uniform(key) * (high - low + 1)).astype(jnp.int32)
    return jnp.minimum(low + n, high)


def hashed(seed: jax.Array, index: jax.Array) -> jax.Array:
    """32 random bits for every index: an integer hash (two rounds of xor-shift and multiply) of seed and index.

    For draws of every step and every cell, which a threefry key for each would make dear.
    """
    x = (index.astype(jnp.uint32) * jnp.uint32(0x9E3779B9)) ^ seed
    x = (x ^ (x >> 16)) * jnp.uint32(0x7FEB352D)
    x = (x ^ (x >> 15)) * jnp.uint32(0x846CA68B)
    return x ^ (x >> 16)


def draw_one(key: jax.Array, step: jax.Array, among: jax.Array) -> jax.Array:
    """One of those for whom `among` is true.

    Args:
        key: the world's key of this episode.
        step: () int32; every step has a draw of its own.
        among: (n, ...) bool, of which one is drawn along the first axis.

    Returns:
        (...) int32, all of `among` equally likely; 0 where it has none.
    """
    seed = hashed(functools.reduce(hashed, jax.random.key_data(key)), step)
    bits = hashed(seed, jnp.arange(among.size)).reshape(among.shape)
    return jnp.where(among, bits | 1, 0).argmax(axis=0).astype(jnp.int32)
