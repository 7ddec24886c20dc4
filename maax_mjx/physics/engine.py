"""The interface that all physics engines share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import jax
import mujoco

from maax_mjx.physics.data import Data
from maax_mjx.physics.mjx_model import MjxModel
from maax_mjx.physics.world import World


class Engine(ABC):
    """Steps worlds of one compiled model. Methods are pure and may be jitted and vmapped.

    Args:
        model: the compiled model; the engine keeps it unchanged.
    """

    impl: ClassVar[str]

    def __init__(self, model: mujoco.MjModel):
        self.mjx = MjxModel(model)

    def init(self, world: World, qpos: jax.Array) -> Data:
        """The state of a world at rest at `qpos` (nq,), everything else reset."""
        return self.mjx.kinematics(world, self.mjx.rest(qpos))

    def step(self, world: World, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        """Advances a world by `n_frames` physics steps under constant controls and forces.

        Returns:
            The state, its poses current, and () bool: whether contacts were left out for want of capacity.
        """
        data, overflow = self._integrate(world, data, n_frames)
        return self.mjx.kinematics(world, data), overflow

    @abstractmethod
    def _integrate(self, world: World, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        """Advances time, qpos, qvel and qacc_warmstart; poses may be stale."""
