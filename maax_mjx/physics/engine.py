"""The interface that all physics engines share."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import jax
import mujoco
import numpy as np

from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay
from maax_mjx.physics.gradients import not_differentiable

STATE = ("time", "qpos", "qvel", "ctrl", "qacc_warmstart", "xfrc_applied")
"""The fields of `Data` that a step starts from, besides `eq_active`."""


class Engine(ABC):
    """Steps worlds of one compiled model. Methods are pure and may be jitted and vmapped.

    Args:
        model: the compiled model; the engine keeps it unchanged.
        overlay: the rows of its fields in which worlds differ.
    """

    impl: ClassVar[str]

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        # MJX takes seconds to import, and only engines need it.
        from maax_mjx.physics.mjx_model import MjxModel

        self.overlay = overlay
        self.mjx = MjxModel(self._mjx_source(model), overlay)
        # Compiled even where an env step is called eagerly: MJX alone has thousands of operations.
        self._compiled = jax.jit(self._differentiable_step, static_argnums=2)

    def _mjx_source(self, model: mujoco.MjModel) -> mujoco.MjModel:
        """The model for MJX's own poses and rest states; without contacts, of which it does not know all kinds."""
        model = copy.copy(model)
        model.geom_contype[:] = model.geom_conaffinity[:] = 0
        return model

    def check_devices(self, n_devices: int) -> None:
        """Refuses more devices in this process than the engine can step on.

        Raises:
            ValueError: saying what to change.
        """
        return

    def init(self, fields: Fields, qpos: jax.Array) -> Data:
        """The state of a world at rest at `qpos` (nq,), everything else reset."""
        data = self.pose(fields, self.mjx.rest(qpos))
        return data.replace(engine=self.carry(data))

    def carry(self, data: Data) -> Any:
        """Returns what this engine carries for a world at its beginning; see `Data.engine`."""
        return ()

    def renew(self, carried: Any, begins: jax.Array) -> Any:
        """Resets what the engine carries where `begins` () says that a world begins a new episode."""
        return carried

    def pose(self, fields: Fields, data: Data) -> Data:
        """The state with the poses that belong to its qpos."""
        return self.mjx.kinematics(fields, data)

    def exact(self, data: Data) -> dict[str, np.ndarray]:
        """The state's time, qpos, qvel, ctrl, qacc_warmstart and xfrc_applied as the engine knows them, flat. Host."""
        return {name: np.ravel(getattr(data, name)).astype(float) for name in STATE}

    def advance(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        """Advances a world by `n_frames` physics steps under constant controls and forces.

        Returns:
            The state, its poses those from before (see `pose`), and () bool: whether contacts were left out for want of
            capacity.

        Raises:
            NotDifferentiableError: where it is differentiated and the engine has no derivatives.
        """
        with jax.named_scope("physics"):
            return self._compiled(fields, data, n_frames)

    @abstractmethod
    def step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        """Does what `advance` does, uncompiled and without regard to derivatives."""

    def _differentiable_step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        message = f"impl={self.impl!r} has no derivatives; make the environment with impl='jax'"
        return not_differentiable(lambda fields, data: self.step(fields, data, n_frames), message)(fields, data)
