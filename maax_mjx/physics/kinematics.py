"""Poses of upright worlds: bodies that hang on the world alone, slide along x, y and z and turn about z.

These need no walk over a tree and no quaternion products. MJX's own kinematics, which serves all other models, takes
several times as long on a CPU, where it would be a fifth of an env step with the C engine.
"""

from __future__ import annotations

import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay

SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
CHAIN = ([SLIDE, SLIDE, SLIDE, HINGE], [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]])


class UprightKinematics:
    """Computes `xpos`, `xquat`, `geom_xpos` and `geom_xmat` of a model for which `applies` holds."""

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        self._geom_pos = model.geom_pos
        self._geom_rows = overlay.get("geom_pos", np.zeros(0, int))
        self._geom_body = model.geom_bodyid.copy()
        moves = model.body_jntnum > 0
        first = np.where(moves, model.jnt_qposadr[np.maximum(model.body_jntadr, 0)], 0)
        # Bodies without joints read a zero put after qpos.
        self._slides = np.where(moves[:, None], first[:, None] + np.arange(3), model.nq)
        self._yaw = np.where(moves, first + 3, model.nq)
        origin = np.append(model.qpos0, 0.0)
        self._offset = model.body_pos - origin[self._slides]
        self._yaw0 = origin[self._yaw]
        mats = np.empty((model.ngeom, 9))
        for mat, quat in zip(mats, model.geom_quat, strict=True):
            mujoco.mju_quat2Mat(mat, quat)
        x, y, z = np.moveaxis(mats.reshape(-1, 3, 3), 1, 0)
        nothing = np.zeros_like(x)
        # Rz(yaw) @ mat = cos * self._cos + sin * self._sin + self._up
        self._cos, self._sin = np.stack([x, y, nothing], axis=1), np.stack([-y, x, nothing], axis=1)
        self._up = np.stack([nothing, nothing, z], axis=1)

    @staticmethod
    def applies(model: mujoco.MjModel, overlay: Overlay) -> bool:
        """Tells whether every body of the model is upright in the sense of this module."""
        if model.nmocap or {"geom_quat", "body_pos", "body_quat", "qpos0"} & set(overlay):
            return False
        types, axes = CHAIN
        for body in range(1, model.nbody):
            joints = slice(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
            if model.body_jntnum[body] and not (
                model.jnt_type[joints].tolist() == types and np.array_equal(model.jnt_axis[joints], axes)
            ):
                return False
            if model.body_parentid[body] != 0 or model.jnt_pos[joints].any():
                return False
        return bool((model.body_quat == [1, 0, 0, 0]).all())

    def __call__(self, fields: Fields, data: Data) -> Data:
        """The state with the poses that belong to its qpos."""
        q = jnp.append(data.qpos, 0.0)
        xpos = self._offset + q[self._slides]
        yaw = q[self._yaw] - self._yaw0
        nothing = jnp.zeros_like(yaw)
        xquat = jnp.stack([jnp.cos(yaw / 2), nothing, nothing, jnp.sin(yaw / 2)], axis=1)
        cos, sin = jnp.cos(yaw)[self._geom_body, None], jnp.sin(yaw)[self._geom_body, None]
        local = jnp.asarray(self._geom_pos)
        if self._geom_rows.size:
            local = local.at[self._geom_rows].set(fields["geom_pos"])
        x, y, z = local[:, :1], local[:, 1:2], local[:, 2:]
        turned = jnp.concatenate([cos * x - sin * y, sin * x + cos * y, z], axis=1)
        return data.replace(
            xpos=xpos,
            xquat=xquat,
            geom_xpos=xpos[self._geom_body] + turned,
            geom_xmat=cos[..., None] * self._cos + sin[..., None] * self._sin + self._up,
        )
