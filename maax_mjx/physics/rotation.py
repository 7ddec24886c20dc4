"""Unit quaternions (w, x, y, z), as MuJoCo has them, along the last axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def conjugate(quat: jax.Array) -> jax.Array:
    """Inverse of unit quaternions, (..., 4)."""
    return jnp.concatenate([quat[..., :1], -quat[..., 1:]], axis=-1)


def multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """Composes rotations, `b` first, then `a`: (..., 4)."""
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(axis=-1, keepdims=True)
    axis = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + jnp.cross(a[..., 1:], b[..., 1:])
    return jnp.concatenate([w, axis], axis=-1)


def rotate(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """Rotates vectors (..., 3) by unit quaternions (..., 4)."""
    # By components: a CPU computes with long axes faster than with ones of three.
    w, a, b, c = (quat[..., i] for i in range(4))
    x, y, z = (vector[..., i] for i in range(3))
    u, v, t = 2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)
    turned = [x + w * u + b * t - c * v, y + w * v + c * u - a * t, z + w * t + a * v - b * u]
    return jnp.stack(turned, axis=-1)
