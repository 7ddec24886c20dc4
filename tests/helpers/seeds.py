"""Keys and seeds of what tests draw: all are moved by `MAAX_TEST_SEED`, so that no test holds for one draw only."""

from __future__ import annotations

import os

import jax
import numpy as np

OFFSET = 1_000 * int(os.environ.get("MAAX_TEST_SEED", "0"))


def seed(n: int) -> int:
    """The seed that `n` stands for in this run."""
    return n + OFFSET


def key(n: int | jax.Array) -> jax.Array:
    """The JAX key that `n` stands for in this run."""
    return jax.random.key(n + OFFSET)


def rng(n: int) -> np.random.Generator:
    """The NumPy generator that `n` stands for in this run."""
    return np.random.default_rng(seed(n))
