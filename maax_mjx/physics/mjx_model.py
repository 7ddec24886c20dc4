"""The MJX model, made on the host and kept as NumPy constants, and what is overlaid on it in traced code."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.physics.data import Data
from maax_mjx.physics.kinematics import UprightKinematics
from maax_mjx.physics.world import Overlay, World


def put_on_host(tree: Any) -> Any:
    """Every array of a tree as a NumPy constant: tied to no device, so safe to close over in any program."""
    return jax.tree.map(np.asarray, tree)


class MjxModel:
    """MJX's own JAX model and data template of a MuJoCo model.

    Args:
        model: the compiled MuJoCo model.
        overlay: the rows in which worlds differ.
    """

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        self._overlay = overlay
        self._upright = UprightKinematics(model, overlay) if UprightKinematics.applies(model, overlay) else None
        # May be reached for the first time inside a traced function: these arrays must not become tracers.
        with jax.ensure_compile_time_eval():
            device = jax.local_devices()[0]
            self._model = put_on_host(mjx.put_model(model, device=device, impl="jax"))
            self._data = put_on_host(mjx.make_data(model, device=device, impl="jax"))

    def overlay(self, world: World) -> mjx.Model:
        """The model of one world."""
        model = jax.tree.map(jnp.asarray, self._model)
        return model.tree_replace(
            {name: getattr(model, name).at[ids].set(world.fields[name]) for name, ids in self._overlay.items()}
        )

    def data(self, data: Data) -> mjx.Data:
        """An mjx.Data that holds this state."""
        template = jax.tree.map(jnp.asarray, self._data)
        return template.replace(
            time=data.time,
            qpos=data.qpos,
            qvel=data.qvel,
            ctrl=data.ctrl,
            qacc_warmstart=data.qacc_warmstart,
            eq_active=data.eq_active,
            xfrc_applied=data.xfrc_applied,
        )

    def kinematics(self, world: World, data: Data) -> Data:
        """The state with the poses that belong to its qpos."""
        if self._upright is not None:
            return self._upright(world, data)
        d = mjx.kinematics(self.overlay(world), self.data(data))
        return data.replace(xpos=d.xpos, xquat=d.xquat, geom_xpos=d.geom_xpos, geom_xmat=d.geom_xmat)

    def rest(self, qpos: jax.Array) -> Data:
        """The state at rest in a configuration (nq,), all forces and controls zero; poses are not computed."""
        d = jax.tree.map(jnp.asarray, self._data)
        return Data(
            time=d.time,
            qpos=qpos,
            qvel=d.qvel,
            ctrl=d.ctrl,
            qacc_warmstart=d.qacc_warmstart,
            eq_active=d.eq_active,
            xfrc_applied=d.xfrc_applied,
            xpos=d.xpos,
            xquat=d.xquat,
            geom_xpos=d.geom_xpos,
            geom_xmat=d.geom_xmat,
        )
