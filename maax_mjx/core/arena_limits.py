"""Joint ranges that close the arena without contacts (`outer="limits"`).

An entity's slides along x and y end where its bounding box, at its current yaw, meets the edge of the floor. The ranges
are data of the world and are written after every physics step, since boxes turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.layout import World
from maax_mjx.modules import Entities
from maax_mjx.modules.placed import turned_extents
from maax_mjx.physics import Data, Overlay

AXES = ("x", "y")
FAR = 1e3
"""Metres of a joint range that is wide open."""
SOLREF, SOLIMP = (0.01, 1.0), (0.99, 0.999, 0.001, 0.5, 2.0)
"""Solver settings as stiff as a step of 5 ms allows: a lock gives 0.2 mm under 200 N, and 4 mm and more with MuJoCo's
defaults."""


def limit_joint(joint: mujoco.MjsJoint, soft: bool = False) -> None:
    """Gives a joint a range that is wide open until data closes it, stiff or with MuJoCo's default softness."""
    joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    joint.range = (-FAR, FAR)
    if not soft:
        joint.solref_limit, joint.solimp_limit = SOLREF, SOLIMP


class ArenaLimits:
    """The joint ranges of an environment's movable entities.

    Args:
        entities: the modules of the entities, without free joints, which have no range.
        timestep: seconds of one physics step.
    """

    def __init__(self, entities: Sequence[Entities], timestep: float):
        self.entities = list(entities)
        self.timestep = timestep

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Adds ranges to the joints; the values are data."""
        for name in self._joint_names():
            limit_joint(spec.joint(name))

    def joint_ids(self, model: mujoco.MjModel) -> np.ndarray:
        """Returns joint ids (2 n,), x and y of every entity in turn."""
        return np.array([model.joint(name).id for name in self._joint_names()], int)

    def write(self, world: World, data: Data, overlay: Overlay, model: mujoco.MjModel) -> World:
        """Returns the world with the joint ranges of its state."""
        ranges = world.fields["jnt_range"]
        rows = np.searchsorted(overlay["jnt_range"], self.joint_ids(model))
        # A closed range is a lock, and stays.
        locked = (ranges[rows, 0] == ranges[rows, 1])[:, None]
        new = jnp.where(locked, ranges[rows], self._ranges(world, data))
        return world.replace(fields=world.fields | {"jnt_range": with_rows(ranges, rows, new)})

    def _ranges(self, world: World, data: Data) -> jax.Array:
        """Returns joint ranges (2 n, 2) in metres, in the order of `joint_ids`; wide open for inactive entities."""
        rows = []
        for module in self.entities:
            extents = module.extents_of(world)
            half = extents[:, :2] / 2
            if not module.is_round:
                yaw, turning = data.qpos[module.qpos_ids[:, 3]], data.qvel[module.qvel_ids[:, 3]]
                # The larger extent of now and after the coming step: a long box sweeps 10 cm in one step.
                now, soon = (turned_extents(extents, yaw + t * turning) for t in (0.0, self.timestep))
                half = jax.lax.stop_gradient(jnp.maximum(now, soon)) / 2
            closed = jnp.stack([half, world.plan.floor_size - half], axis=-1)
            rows.append(jnp.where(world.active[module.kind][:, None, None], closed, jnp.array([-FAR, FAR])))
        return jnp.concatenate(rows).reshape(-1, 2)

    def _joint_names(self) -> list[str]:
        return [f"{name}:{axis}" for module in self.entities for name in module.names for axis in AXES]
