"""The physics state that every engine reads and writes."""

from __future__ import annotations

from typing import Any

import jax
from flax import struct


class Data(struct.PyTreeNode):
    """One world's physics, under MuJoCo's field names. These fields are the truth: a step starts from them alone.

    Poses (xpos, xquat, geom_xpos, geom_xmat) belong to `qpos`; they do not lag a step behind as `mjData`'s do.

    Attributes:
        time: () seconds since the world's reset.
        qpos: (nq,) generalised positions: metres, radians.
        qvel: (nv,) generalised velocities.
        ctrl: (nu,) controls of the last step.
        qacc_warmstart: (nv,) the solver's starting point.
        eq_active: (neq,) bool, which equality constraints hold.
        xfrc_applied: (nbody, 6) external force and torque on every body, N and Nm, in the world frame.
        xpos: (nbody, 3) body positions in metres.
        xquat: (nbody, 4) body orientations.
        geom_xpos: (ngeom, 3) geom positions in metres.
        geom_xmat: (ngeom, 3, 3) geom orientations.
        engine: what the engine carries from step to step besides; private to it.
    """

    time: jax.Array
    qpos: jax.Array
    qvel: jax.Array
    ctrl: jax.Array
    qacc_warmstart: jax.Array
    eq_active: jax.Array
    xfrc_applied: jax.Array
    xpos: jax.Array
    xquat: jax.Array
    geom_xpos: jax.Array
    geom_xmat: jax.Array
    engine: Any = ()
