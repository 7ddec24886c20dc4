"""The MJX model, made on the host and kept as NumPy constants, and what is overlaid on it in traced code."""

from __future__ import annotations

import copy
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
from maax_mjx.physics.mjx_internals import contact_dimensions


def put_on_host(tree: Any) -> Any:
    """Makes every array of a tree a NumPy constant: tied to no device, so safe to close over in any program."""
    return jax.tree.map(np.asarray, tree)


INPUTS = ("time", "qpos", "qvel", "ctrl", "qacc_warmstart", "eq_active", "xfrc_applied")
"""The fields of `Data` that an mjx.Data is filled from."""


LEAST_FRICTION = np.array([1e-2, mujoco.mjMINMU, mujoco.mjMINMU])
"""Sliding, torsional and rolling friction of a geom at least. A sliding one of f makes the rows of a contact 1 / f^2
times as stiff across it as along it, more than float32 can tell apart at C MuJoCo's least, 1e-5: Warp made NaN of boxes
that slid with 3e-3 and bore 5e-3, and MJX moved agents that slid with 1e-5 5 % too far. 1e-2 is that of published
games."""


def with_friction(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a copy whose geoms have the least friction that float32 bears; those without friction need none."""
    model = copy.copy(model)
    rubs = model.geom_condim > 1
    model.geom_friction[rubs] = np.maximum(model.geom_friction[rubs], LEAST_FRICTION)
    return model


def overlaid(model: mjx.Model, overlay: Overlay, fields: Fields) -> mjx.Model:
    """An mjx.Model of any implementation, kept on the host, with one world's rows in it."""
    model = jax.tree.map(jnp.asarray, model)
    rows = {}
    for name, ids in overlay.items():
        field = attrgetter(name)(model)
        # Warp keeps the two halves of geom_aabb on an axis of their own.
        new = fields[name].reshape(len(ids), *field.shape[1:])
        rows[name] = field.at[ids].set(jnp.maximum(new, LEAST_FRICTION) if name == "geom_friction" else new)
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
        model = with_friction(model)
        with jax.ensure_compile_time_eval():
            device = jax.local_devices()[0]
            self._model = put_on_host(mjx.put_model(model, device=device, impl="jax"))
            self._data = put_on_host(mjx.make_data(model, device=device, impl="jax"))

    @property
    def contact_dimensions(self) -> np.ndarray:
        """(n_contacts,) dimensions of the contact points that there is room for."""
        return contact_dimensions(self._data)

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
