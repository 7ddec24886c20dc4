"""Model fields that worlds may differ in, and which of them go together (MuJoCo computes the rest when it compiles)."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.physics.fields import Fields, Overlay

SIZE_FIELDS = ("geom_size", "geom_rbound", "geom_aabb")
BOX_FIELDS = ("geom_pos", *SIZE_FIELDS)
BODY_FIELDS = ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0")
DOF_FIELDS = ("dof_M0", "dof_invweight0")


def mass_rows(bodies: np.ndarray, dofs: np.ndarray) -> Overlay:
    """The rows that `set_masses` writes."""
    return dict.fromkeys(BODY_FIELDS, bodies) | dict.fromkeys(DOF_FIELDS, dofs.reshape(-1))


def set_boxes(fields: Mapping[str, jax.Array], ids: np.ndarray, half: jax.Array) -> Fields:
    """Resizes box geoms, with the bounds that broad phases read.

    Args:
        fields: whole model fields, `SIZE_FIELDS` among them.
        ids: (n,) geom ids.
        half: (n, 3) half extents in metres.
    """
    return _set_sizes(fields, ids, half, half)


def set_cylinders(fields: Mapping[str, jax.Array], ids: np.ndarray, half: jax.Array) -> Fields:
    """Resizes upright cylinder geoms: `half` (n, 3) is radius, radius and half the height; see `set_boxes`."""
    size = jnp.concatenate([half[:, :1], half[:, 2:], jnp.zeros_like(half[:, :1])], axis=1)
    return _set_sizes(fields, ids, size, half)


def _set_sizes(fields: Mapping[str, jax.Array], ids: np.ndarray, size: jax.Array, half: jax.Array) -> Fields:
    aabb = jnp.concatenate([jnp.zeros_like(half), half], axis=1)
    return dict(fields) | {
        "geom_size": with_rows(fields["geom_size"], ids, size),
        "geom_rbound": with_rows(fields["geom_rbound"], ids, jnp.linalg.norm(size, axis=1)),
        "geom_aabb": with_rows(fields["geom_aabb"], ids, aabb),
    }


def set_masses(
    fields: Mapping[str, jax.Array], bodies: np.ndarray, dofs: np.ndarray, mass: jax.Array, inertia: jax.Array
) -> Fields:
    """Sets the mass of bodies that hang on the world by slides and turning joints, or by a free joint.

    The inverse weights, by which MuJoCo scales constraints, are those of `mj_setConst`: of slides 1 / mass, of hinges
    1 / inertia, of a free joint's rotations the mean of these. `dof_M0` is what C MuJoCo takes for the mass matrix of
    such bodies.

    Args:
        fields: whole model fields, those of `mass_rows` among them.
        bodies: (n,) body ids.
        dofs: (n, 4) dof ids of x, y, z and yaw; (n, 6) of a free joint.
        mass: (n,) kg.
        inertia: (n, 3) about the body's axes, kg m^2.
    """
    heavy = jnp.repeat(mass[:, None], 3, axis=1)
    if dofs.shape[1] == 4:
        about = inertia[:, 2:]
        turning = 1 / about
        mean = turning / 3
    else:
        about = inertia
        mean = (1 / about).mean(axis=1, keepdims=True)
        turning = jnp.repeat(mean, 3, axis=1)
    light = 1 / heavy
    return dict(fields) | {
        "body_mass": with_rows(fields["body_mass"], bodies, mass),
        "body_inertia": with_rows(fields["body_inertia"], bodies, inertia),
        "body_subtreemass": with_rows(fields["body_subtreemass"], bodies, mass),
        "body_invweight0": with_rows(fields["body_invweight0"], bodies, jnp.concatenate([light[:, :1], mean], axis=1)),
        "dof_M0": with_rows(fields["dof_M0"], dofs, jnp.concatenate([heavy, about], axis=1)),
        "dof_invweight0": with_rows(fields["dof_invweight0"], dofs, jnp.concatenate([light, turning], axis=1)),
    }


def box_inertia(mass: jax.Array, extents: jax.Array) -> jax.Array:
    """Inertia of solid boxes, (n, 3) in kg m^2, from their mass (n,) in kg and extents (n, 3) in metres."""
    squares = extents**2
    return mass[:, None] / 12 * (squares.sum(axis=1, keepdims=True) - squares)


def cylinder_inertia(mass: jax.Array, extents: jax.Array) -> jax.Array:
    """Inertia of solid upright cylinders, (n, 3) in kg m^2; extents (n, 3) are diameter, diameter, height in metres."""
    r2, h2 = extents[:, 0] ** 2 / 4, extents[:, 2] ** 2
    across = mass * (3 * r2 + h2) / 12
    return jnp.stack([across, across, mass * r2 / 2], axis=1)
