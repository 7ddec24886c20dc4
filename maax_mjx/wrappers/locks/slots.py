"""The constraints that hold locked objects, built into the model once, switched and aimed as data."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.core.arena_limits import FAR, limit_joint
from maax_mjx.core.state import State
from maax_mjx.modules import Entities, Module
from maax_mjx.physics import Data, Overlay
from maax_mjx.wrappers.equalities import add_equality, joint_data, set_equalities, weld_data

METHODS = ("equality", "joint_range")
JOINTS = ("x", "y", "z", "yaw")
N_POSE = 7


class LockSlots(Module):
    """One lock for every slot of some modules.

    Args:
        modules: whose objects.
        method: "equality": a joint equality for every slide and hinge, a weld to the world for a free joint;
            "joint_range": the range of every joint, open or closed.

    Raises:
        ValueError: joint ranges of free joints.
    """

    name = "lock_slots"

    def __init__(self, modules: Sequence[Entities], method: str):
        self.modules, self.method = list(modules), method
        for module in modules:
            if method == "joint_range" and module.free:
                raise ValueError(
                    f"method: got 'joint_range'; the free joints of {module.name} have none; takes 'equality'"
                )
        self.names = [(name, module.free) for module in modules for name in module.names]

    @property
    def overlay(self) -> Overlay:
        return {"eq_data": self._eq_ids} if self.method == "equality" else {"jnt_range": self._jnt_ids}

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        for name, free in self.names:
            for joint in () if free else JOINTS:
                if self.method == "joint_range":
                    limit_joint(spec.joint(f"{name}:{joint}"))
                else:
                    add_equality(spec, f"{name}:lock:{joint}", mujoco.mjtEq.mjEQ_JOINT, f"{name}:{joint}")
            if free:
                add_equality(spec, f"{name}:lock:weld", mujoco.mjtEq.mjEQ_WELD, "world", name)

    def cache_step(self, model: mujoco.MjModel) -> None:
        slots = list(enumerate(self.names))
        joints = [(slot, axis, f"{name}:{joint}") for slot, (name, free) in slots if not free
                  for axis, joint in enumerate(JOINTS)]  # fmt: skip
        welds = [(slot, f"{name}:lock:weld") for slot, (name, free) in slots if free]
        self._joint_slot = np.array([slot for slot, *_ in joints], int)
        self._joint_axis = np.array([axis for _, axis, _ in joints], int)
        self._qpos0 = np.array([model.qpos0[model.joint(name).qposadr[0]] for *_, name in joints])
        if self.method == "joint_range":
            self._jnt_ids = np.array([model.joint(name).id for *_, name in joints], int)
            return
        of_joint = [model.eq(name.replace(":", ":lock:")).id for *_, name in joints]
        self._weld_slot = np.array([slot for slot, _ in welds], int)
        self._eq_ids = np.array(of_joint + [model.eq(name).id for _, name in welds], int)

    def pose(self, data: Data) -> jax.Array:
        """(n, 7) the qpos of every object, padded with zeros."""
        rows = [data.qpos[m.qpos_ids] for m in self.modules]
        return jnp.concatenate([jnp.pad(q, ((0, 0), (0, N_POSE - q.shape[1]))) for q in rows])

    def hold(self, state: State, locked: jax.Array, pose: jax.Array, overlay: Overlay) -> State:
        """The state with locked objects held at their poses, and all others free.

        Args:
            state: before a step.
            locked: (n,) bool.
            pose: (n, 7), see `pose`.
            overlay: the environment's.
        """
        value = pose[self._joint_slot, self._joint_axis]
        if self.method == "joint_range":
            rows = np.searchsorted(overlay["jnt_range"], self._jnt_ids)
            closed = jnp.stack([value, value], axis=1)
            ranges = jnp.where(locked[self._joint_slot][:, None], closed, jnp.array([-FAR, FAR]))
            fields = state.world.fields
            fields = fields | {"jnt_range": with_rows(fields["jnt_range"], rows, ranges)}
            return state.replace(world=state.world.replace(fields=fields))
        data = jnp.concatenate([joint_data(value - self._qpos0, 0.0), weld_data(pose[self._weld_slot])])
        slots = np.concatenate([self._joint_slot, self._weld_slot])
        return set_equalities(state, overlay, self._eq_ids, data, locked[slots])
