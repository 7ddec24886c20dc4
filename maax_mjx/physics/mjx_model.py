"""The MJX model, made on the host and kept as NumPy constants, and what is overlaid on it in traced code."""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay


def put_on_host(tree: Any) -> Any:
    """Makes every array of a tree a NumPy constant: tied to no device, so safe to close over in any program."""
    return jax.tree.map(np.asarray, tree)


INPUTS = ("time", "qpos", "qvel", "ctrl", "qacc_warmstart", "eq_active", "xfrc_applied")
"""The fields of `Data` that an mjx.Data is filled from."""


def overlaid(model: mjx.Model, overlay: Overlay, fields: Fields) -> mjx.Model:
    """An mjx.Model of any implementation, kept on the host, with one world's rows in it."""
    model = jax.tree.map(jnp.asarray, model)
    rows = {}
    for name, ids in overlay.items():
        field = attrgetter(name)(model)
        # Warp keeps the two halves of geom_aabb on an axis of their own.
        rows[name] = field.at[ids].set(fields[name].reshape(len(ids), *field.shape[1:]))
    return model.tree_replace(rows)


def state_of(data: Data) -> dict[str, jax.Array]:
    """Returns the fields of a state that an mjx.Data is filled from."""
    return {name: getattr(data, name) for name in INPUTS}


class MjxModel:
    """MJX's own JAX model and data template of a MuJoCo model.

    Args:
        model: the compiled MuJoCo model.
        overlay: the rows in which worlds differ.
    """

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        self._overlay = overlay
        # May be reached for the first time inside a traced function: these arrays must not become tracers.
        with jax.ensure_compile_time_eval():
            device = jax.local_devices()[0]
            self._model = put_on_host(mjx.put_model(model, device=device, impl="jax"))
            self._data = put_on_host(mjx.make_data(model, device=device, impl="jax"))

    def overlay(self, fields: Fields) -> mjx.Model:
        """The model of one world, whose fields these are."""
        return overlaid(self._model, self._overlay, fields)

    def data(self, state: Mapping[str, jax.Array]) -> mjx.Data:
        """An mjx.Data with a state in it; see `state_of`."""
        return jax.tree.map(jnp.asarray, self._data).replace(**state)

    def kinematics(self, fields: Fields, data: Data) -> Data:
        """The state with the poses that belong to its qpos."""
        d = mjx.kinematics(self.overlay(fields), self.data(state_of(data)))
        return data.replace(xpos=d.xpos, xquat=d.xquat, geom_xpos=d.geom_xpos, geom_xmat=d.geom_xmat)

    def velocities(self, fields: Fields, data: Data) -> dict[str, jax.Array]:
        """The spatial motion of bodies and joints (`cvel`, `cdof_dot`) that belongs to the state's qpos and qvel."""
        model, d = self.overlay(fields), self.data(state_of(data))
        for stage in (mjx.kinematics, mjx.com_pos, mjx.com_vel):
            d = stage(model, d)
        return {"cvel": d.cvel, "cdof_dot": d.cdof_dot}
