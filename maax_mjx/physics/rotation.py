"""Unit quaternions (w, x, y, z), as MuJoCo has them, along the last axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def conjugate(quat: jax.Array) -> jax.Array:
    """The opposite turn: (..., 4)."""
    return jnp.concatenate([quat[..., :1], -quat[..., 1:]], axis=-1)


def multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """The turn `b`, then `a`: (..., 4)."""
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(axis=-1, keepdims=True)
    axis = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + jnp.cross(a[..., 1:], b[..., 1:])
    return jnp.concatenate([w, axis], axis=-1)


def rotate(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """Vectors (..., 3) turned."""
    w, axis = quat[..., :1], quat[..., 1:]
    across = 2 * jnp.cross(axis, vector)
    return vector + w * across + jnp.cross(axis, across)
