"""The engine impl="jax": MJX's JAX physics, with a faster solver. Any accelerator, differentiable, the reference."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.physics import newton
from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay
from maax_mjx.physics.gradients import with_jacobian
from maax_mjx.physics.mjx_engine import MjxEngine
from maax_mjx.physics.mjx_internals import check_internals, contact_distances
from maax_mjx.physics.mjx_model import state_of

STARTS = ("qpos", "qvel", "ctrl", "xfrc_applied")
"""Fields of `Data` that a step is differentiable in."""

NO_CYLINDERS = (int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH))
"""Kinds of geoms that MJX has no contacts of with a cylinder."""

NO_GRADIENT = (
    "gradients are taken with respect to actions and the state's qpos, qvel, ctrl and xfrc_applied; "
    "got a derivative with respect to the fields of the world"
)


class JaxEngine(MjxEngine):
    """Rebuilds the mjx.Data from a template at every step: all of it is recomputed anyway, and nothing is carried.

    Differentiable, forward and reverse, in what is named in `STARTS`. A derivative through a step costs as many
    forward derivatives as these have numbers, whatever its direction.

    Args:
        model: the compiled model; its numeric `max_contact_points` is how many contact points are kept.
        overlay: the rows in which worlds differ.
        contacts_per_world: that number.

    Raises:
        RuntimeError: the installed MJX is not one that `mjx_internals` knows.
        ValueError: the model has cylinders that could touch boxes or meshes.
    """

    impl = "jax"

    def __init__(self, model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int):
        check_internals("jax")
        super().__init__(model, overlay)
        self.contacts_per_world = contacts_per_world
        self._is_convex = newton.applies(model)
        self._frame_with_jacobian = with_jacobian(self._frame, NO_GRADIENT)

    def _mjx_source(self, model: mujoco.MjModel) -> mujoco.MjModel:
        moving = model.body_weldid[model.geom_bodyid] > 0
        cylinders, others = model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER, np.isin(model.geom_type, NO_CYLINDERS)
        if ((cylinders & moving).any() and others.any()) or (cylinders.any() and (others & moving).any()):
            raise ValueError(
                "impl: got 'jax'; MJX has no contacts between a cylinder and a box, wall or ramp; "
                "takes 'warp' or 'c' there"
            )
        return model

    def step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        def frame(data: Data, _: None) -> tuple[Data, jax.Array]:
            # Poses and what else the engine does not read have derivatives of their own: they stay outside.
            starts = {name: getattr(data, name) for name in STARTS}
            fixed = {name: getattr(data, name) for name in ("time", "qacc_warmstart", "eq_active")}
            moved, (rest, overflow) = self._frame_with_jacobian(starts, (fields, jax.lax.stop_gradient(fixed)))
            return data.replace(**moved, **rest), overflow

        if n_frames == 1:
            return frame(data, None)
        data, overflow = jax.lax.scan(frame, data, length=n_frames)
        return data, overflow.any()

    def _differentiable_step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        return self.step(fields, data, n_frames)

    def mjx_model(self, fields: Fields) -> mjx.Model:
        return self.mjx.overlay(fields)

    def mjx_data(self, data: Data, n_worlds: int) -> mjx.Data:
        return self.mjx.data(state_of(data))

    def mjx_step(self, model: mjx.Model, data: mjx.Data) -> mjx.Data:
        return newton.step(model, data) if self._is_convex else mjx.step(model, data)

    def _frame(self, starts: dict[str, jax.Array], fixed: tuple[Fields, dict[str, jax.Array]]) -> tuple:
        fields, others = fixed
        d = self.mjx_step(self.mjx.overlay(fields), self.mjx.data(starts | others))
        dist, dimensions = contact_distances(d), self.mjx.contact_dimensions
        # The deepest contacts of a dimension are kept: some may be missing only if there is no room left and every kept
        # one is active.
        kept = (dist[dimensions == n] for n in np.unique(dimensions))
        full = [(x < 0).all() for x in kept if x.size >= self.contacts_per_world]
        overflow = jnp.stack(full).any() if full else jnp.zeros((), bool)
        rest = {"time": d.time, "qacc_warmstart": d.qacc_warmstart}
        return {"qpos": d.qpos, "qvel": d.qvel}, (rest, overflow)
