"""Array operations that several rooms need."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def with_rows(array: jax.Array, rows: np.ndarray, values: jax.Array) -> jax.Array:
    """Computes `array.at[rows].set(values)` as a gather: a scatter is a loop on a CPU, slower to run and to compile."""
    source = np.arange(len(array))
    source[rows.ravel()] = len(array) + np.arange(rows.size)
    return jnp.concatenate([array, values.astype(array.dtype).reshape(rows.size, *array.shape[1:])])[source]


def null_rows(arrays: dict[str, jax.Array], who: jax.Array) -> dict[str, jax.Array]:
    """Returns arrays (n_agents, ...) with zeros for the agents in `who`, a mask (n_agents,)."""
    return {name: shown(x, ~who) for name, x in arrays.items()}


def shown(array: jax.Array, mask: jax.Array) -> jax.Array:
    """Returns the array with zeros where a mask over its leading axes is false."""
    return jnp.where(mask.reshape(*mask.shape, *[1] * (array.ndim - mask.ndim)), array, jnp.zeros_like(array))


def strong(tree: Any) -> Any:
    """Returns arrays of the same types that Python's numbers do not adapt to.

    What `2.0 * x` of a wrapper gives may be weakly typed where the state before was not; a program that gets both is
    compiled twice.
    """
    return jax.tree.map(lambda x: x.astype(x.dtype) if getattr(x, "weak_type", False) else x, tree)


def running_mean(mean: jax.Array, x: jax.Array, counts: jax.Array, n: jax.Array) -> jax.Array:
    """Returns the mean of n numbers, of which the last one is x if it counts, from the mean before."""
    return mean + (x - mean) * counts / jnp.maximum(n, 1)
