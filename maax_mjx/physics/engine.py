"""The interface that all physics engines share."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.runtime import import_mjx
from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay
from maax_mjx.physics.gradients import not_differentiable
from maax_mjx.physics.kinematics import UprightKinematics

if TYPE_CHECKING:
    from maax_mjx.physics.mjx_model import MjxModel

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
        self.overlay = overlay
        self._upright = UprightKinematics(model, overlay) if UprightKinematics.applies(model, overlay) else None
        self._source = self._mjx_source(model)
        self._rest = _rest(model)
        # Compiled even where an env step is called eagerly: MJX alone has thousands of operations.
        self._compiled = jax.jit(self._differentiable_step, static_argnums=2)

    @cached_property
    def mjx(self) -> MjxModel:
        """MJX's own model."""
        # MJX takes seconds to import, which the engine `c` does without in worlds whose bodies stay upright.
        import_mjx()
        from maax_mjx.physics.mjx_model import MjxModel

        return MjxModel(self._source, self.overlay)

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
        rest = jax.tree.map(lambda x: jnp.asarray(x, bool if x.dtype == bool else qpos.dtype), self._rest)
        data = self.pose(fields, rest.replace(qpos=qpos))
        return data.replace(engine=self.carry(data))

    def carry(self, data: Data) -> Any:
        """Returns what this engine carries for a world at its beginning; see `Data.engine`."""
        return ()

    def renew(self, carried: Any, begins: jax.Array) -> Any:
        """Resets what the engine carries where `begins` () says that a world begins a new episode."""
        return carried

    def pose(self, fields: Fields, data: Data) -> Data:
        """The state with the poses that belong to its qpos."""
        return (self._upright or self.mjx.kinematics)(fields, data)

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


def _rest(model: mujoco.MjModel) -> Data:
    """The state of a model at rest, with NumPy arrays, tied to no device; qpos and poses are still to be computed."""
    n, bodies, geoms = model.nv, model.nbody, model.ngeom

    def zeros(*shape: int) -> Any:
        return np.zeros(shape, np.float32)

    return Data(
        time=zeros(),
        qpos=zeros(model.nq),
        qvel=zeros(n),
        ctrl=zeros(model.nu),
        qacc_warmstart=zeros(n),
        eq_active=np.asarray(model.eq_active0, bool),  # type: ignore[arg-type]
        xfrc_applied=zeros(bodies, 6),
        xpos=zeros(bodies, 3),
        xquat=zeros(bodies, 4),
        geom_xpos=zeros(geoms, 3),
        geom_xmat=zeros(geoms, 3, 3),
    )
