"""impl="c": MuJoCo's C engine behind the same jitted, vmapped step, through one host callback."""

from __future__ import annotations

import copy
from collections import defaultdict, deque
from math import prod

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.world import World

STATE = ("time", "qpos", "qvel", "ctrl", "qacc_warmstart", "eq_active", "xfrc_applied")
ADVANCED = ("time", "qpos", "qvel", "qacc_warmstart")
MAX_SIZES = 8
FULL_WARNINGS = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class CEngine(Engine):
    """Borrows a `mujoco.batch.Batch` of the right size for every call: no Batch ever serves two threads at once."""

    impl = "c"

    def __init__(self, model: mujoco.MjModel):
        super().__init__(model)
        self._model = copy.copy(model)
        disable = mujoco.mjtDisableBit
        # Autoreset would put a diverged world back to qpos0 unseen; the midphase reads bounding volumes of walls that
        # are overlaid, and those of the world body cannot be.
        self._model.opt.disableflags |= int(disable.mjDSBL_AUTORESET) | int(disable.mjDSBL_MIDPHASE)
        # Not thread-local: XLA's threads drop their Python state after every callback, and the batch with it.
        self._idle: defaultdict[int, deque[Batch]] = defaultdict(deque)

    def _integrate(self, world: World, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        # One array in and one out: the callback's cost is per array, not per byte.
        inputs = {name: getattr(data, name) for name in STATE} | world.fields
        shapes = {name: value.shape for name, value in inputs.items()}
        packed = jnp.concatenate([value.astype(jnp.float32).reshape(-1) for value in inputs.values()])
        n_out = sum(inputs[name].size for name in ADVANCED) + 1
        out = jax.pure_callback(
            lambda packed: self._step_batch(packed, shapes, n_frames),
            jax.ShapeDtypeStruct((n_out,), jnp.float32),
            packed,
            vmap_method="broadcast_all",
        )
        ends = np.cumsum([inputs[name].size for name in ADVANCED])
        parts = jnp.split(out, ends)
        advanced = {name: part.reshape(shapes[name]) for name, part in zip(ADVANCED, parts, strict=False)}
        return data.replace(**advanced), parts[-1][0] > 0

    def _borrow(self, n_worlds: int) -> Batch:
        try:
            return self._idle[n_worlds].pop()
        except IndexError:
            for n in list(self._idle)[:-MAX_SIZES]:
                self._idle.pop(n, None)
            return Batch(self._model, n_worlds)

    def _step_batch(
        self, packed: np.ndarray, shapes: dict[str, tuple[int, ...]], n_frames: int
    ) -> np.ndarray:
        """Host side: rows of all inputs side by side, with any leading axes, which are one batch of worlds here."""
        rows = np.asarray(packed)
        lead = rows.shape[:-1]
        rows = rows.reshape(-1, rows.shape[-1])
        batch = self._borrow(len(rows))
        start = 0
        for name, shape in shapes.items():
            end = start + prod(shape)
            target = batch.bind(name) if name in STATE else batch.expand(name)
            target[...] = rows[:, start:end].reshape(target.shape)
            start = end
        batch.warning[...] = 0
        failed = np.zeros(0, int)
        try:
            batch.step(nstep=n_frames)
        except SimulationError as error:
            failed = error.ids
        parts = [batch.bind(name).reshape(len(rows), -1) for name in ADVANCED]
        full = (batch.warning[:, FULL_WARNINGS, 1] > 0).any(axis=1)
        out = np.concatenate([*parts, full[:, None]], axis=1, dtype=np.float32, casting="same_kind")
        # A world in which MuJoCo raised kept its old state: NaN makes it the fault that it is.
        out[failed, :-1] = np.nan
        self._idle[len(rows)].append(batch)
        return out.reshape(*lead, -1)
