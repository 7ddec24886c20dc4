"""The constraints that hold locked objects: built into the model once, switched and aimed through data."""

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
from maax_mjx.modules.from_model import from_model
from maax_mjx.physics import Data, Overlay
from maax_mjx.wrappers.equalities import add_equality, joint_data, set_equalities, weld_data

METHODS = ("equality", "joint_range")
JOINTS = ("x", "y", "z", "yaw")
N_POSE = 7
"""Numbers of a pose, without joints inside: a free joint's qpos, or an upright object's padded with zeros."""


class LockSlots(Module):
    """One lock for every object slot of some modules, which holds the joints inside of objects too.

    Args:
        name: name of this module.
        modules: modules of the objects.
        method: "equality" builds a joint equality for every slide and hinge, and a weld to the world for a free joint;
            "joint_range" opens or closes every joint's range.
        soft: whether locks have MuJoCo's default softness.

    Raises:
        ValueError: joint ranges of free joints, or of objects with joints inside, which have ranges of their own.
    """

    def __init__(self, name: str, modules: Sequence[Entities], method: str, soft: bool = False):
        self.name, self.modules, self.method, self.soft = name, list(modules), method, soft
        for module in modules:
            if method == "joint_range" and module.free:
                raise ValueError(
                    f"method: got 'joint_range'; the free joints of {module.name} have none; takes 'equality'"
                )
            if method == "joint_range" and module.inner:
                raise ValueError(
                    f"method: got 'joint_range'; the joints inside of {module.name} have ranges of their own; takes "
                    "'equality'"
                )
        self.names = [(slot, module.free) for module in modules for slot in module.names]
        self.n_pose = N_POSE + max((len(module.inner) for module in modules), default=0)

    @property
    def overlay(self) -> Overlay:
        return {"eq_data": self._eq_ids} if self.method == "equality" else {"jnt_range": self._jnt_ids}

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        for *_, joint in self._joints:
            if self.method == "joint_range":
                limit_joint(spec.joint(joint), self.soft)
            else:
                add_equality(spec, _lock_of(joint), mujoco.mjtEq.mjEQ_JOINT, joint, soft=self.soft)
        for name, free in self.names:
            if free:
                add_equality(spec, f"{name}:lock:weld", mujoco.mjtEq.mjEQ_WELD, "world", name, soft=self.soft)

    @property
    def _joints(self) -> list[tuple[int, int, str]]:
        """Slot, column of `pose` and name of every slide and hinge."""
        inner = [module.inner for module in self.modules for _ in module.names]
        joints = []
        for slot, ((name, free), inside) in enumerate(zip(self.names, inner, strict=True)):
            own = [] if free else list(enumerate(JOINTS))
            own += [(N_POSE + i, joint.name) for i, joint in enumerate(inside)]
            joints += [(slot, column, f"{name}:{joint}") for column, joint in own]
        return joints

    @property
    def _joint_slot(self) -> np.ndarray:
        return np.array([slot for slot, *_ in self._joints], int)

    @property
    def _joint_axis(self) -> np.ndarray:
        return np.array([axis for _, axis, _ in self._joints], int)

    @property
    def _weld_slot(self) -> np.ndarray:
        return np.array([slot for slot, (_, free) in enumerate(self.names) if free], int)

    @from_model
    def _qpos0(self) -> np.ndarray:
        return np.array([self.model.qpos0[self.model.joint(name).qposadr[0]] for *_, name in self._joints])

    @from_model
    def _jnt_ids(self) -> np.ndarray:
        return np.array([self.model.joint(name).id for *_, name in self._joints], int)

    @from_model
    def _eq_ids(self) -> np.ndarray:
        of_joints = [self.model.eq(_lock_of(name)).id for *_, name in self._joints]
        of_welds = [self.model.eq(f"{self.names[slot][0]}:lock:weld").id for slot in self._weld_slot]
        return np.array(of_joints + of_welds, int)

    def pose(self, data: Data) -> jax.Array:
        """Returns the qpos (n, n_pose) of every object: 7 columns and those of the joints inside, padded with zeros."""

        def padded(qpos: jax.Array, width: int) -> jax.Array:
            return jnp.pad(qpos, ((0, 0), (0, width - qpos.shape[1])))

        rows = [padded(data.qpos[m.qpos_ids], N_POSE) for m in self.modules]
        if self.n_pose > N_POSE:
            inside = [padded(data.qpos[m.inner_qpos_ids], self.n_pose - N_POSE) for m in self.modules]
            rows = [jnp.concatenate(pair, axis=1) for pair in zip(rows, inside, strict=True)]
        return jnp.concatenate(rows)

    def hold(self, state: State, locked: jax.Array, pose: jax.Array, overlay: Overlay) -> State:
        """Holds locked objects at their poses, and frees all others.

        Args:
            state: a state before a step.
            locked: (n,) bool, whether an object is locked.
            pose: (n, n_pose) poses as from `pose`.
            overlay: the environment's overlay.
        """
        value = pose[self._joint_slot, self._joint_axis]
        if self.method == "joint_range":
            rows = np.searchsorted(overlay["jnt_range"], self._jnt_ids)
            closed = jnp.stack([value, value], axis=1)
            ranges = jnp.where(locked[self._joint_slot][:, None], closed, jnp.array([-FAR, FAR]))
            fields = state.world.fields
            fields = fields | {"jnt_range": with_rows(fields["jnt_range"], rows, ranges)}
            return state.replace(world=state.world.replace(fields=fields))
        data = jnp.concatenate([joint_data(value - self._qpos0, 0.0), weld_data(pose[self._weld_slot, :N_POSE])])
        slots = np.concatenate([self._joint_slot, self._weld_slot])
        return set_equalities(state, overlay, self._eq_ids, data, locked[slots])


def _lock_of(joint: str) -> str:
    """The name of a joint's equality: "box0:lock:x" for "box0:x"."""
    return joint.replace(":", ":lock:", 1)
