"""Velocity terms of connects between bodies, which MJX leaves out."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.physics.mjx_internals import add_to_connects


def with_velocity_terms(m: mjx.Model, d: mjx.Data) -> mjx.Data:
    """Returns the data with the connects' reference accelerations as MuJoCo has them.

    MuJoCo subtracts the relative acceleration that the two points would have if no joint accelerated: centripetal and
    Coriolis terms, the Jacobian's time derivative times the velocity. MJX does not. Connects of sites stay as MJX
    has them, which no module makes, and welds, which locks make of what is at rest.

    Args:
        m: the model.
        d: data with the rows of `mjx.fwd_position` and the velocities of `mjx.fwd_velocity`.
    """
    connects = np.nonzero(m.eq_type == mujoco.mjtEq.mjEQ_CONNECT)[0]
    of_bodies = m.eq_objtype[connects] == mujoco.mjtObj.mjOBJ_BODY
    ids, off = connects[of_bodies], mujoco.mjtDisableBit.mjDSBL_EQUALITY | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    if not ids.size or m.opt.disableflags & off:
        return d
    spatial = _moved_by(m) @ (d.cdof_dot * d.qvel[:, None])

    def accelerations(bodies: np.ndarray, anchors: jax.Array) -> jax.Array:
        points = d.xpos[bodies] + jnp.einsum("nij,nj->ni", d.xmat[bodies], anchors)
        offset = points - d.subtree_com[m.body_rootid[bodies]]
        turn, velocity = d.cvel[bodies, :3], d.cvel[bodies, 3:]
        own = spatial[bodies, 3:] + jnp.cross(spatial[bodies, :3], offset)
        return own + jnp.cross(turn, velocity + jnp.cross(turn, offset))

    relative = accelerations(m.eq_obj1id[ids], m.eq_data[ids, :3]) - accelerations(
        m.eq_obj2id[ids], m.eq_data[ids, 3:6]
    )
    return add_to_connects(d, np.nonzero(of_bodies)[0], -relative * d.eq_active[ids].astype(relative.dtype)[:, None])


def _moved_by(m: mjx.Model) -> np.ndarray:
    """Tells whether a body is moved by a degree of freedom: (nbody, nv), 0 or 1."""
    moved = np.zeros((m.nbody, m.nv), np.float32)
    for body in range(1, m.nbody):
        moved[body] = moved[m.body_parentid[body]] + (m.dof_bodyid == body)
    return moved
