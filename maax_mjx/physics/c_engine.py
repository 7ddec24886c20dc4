"""impl="c": MuJoCo's C engine behind the same jitted, vmapped step, through one host callback."""

from __future__ import annotations

import copy
from collections import defaultdict, deque

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import STATE, Engine
from maax_mjx.physics.world import Overlay, World

ADVANCED = ("time", "qpos", "qvel", "qacc_warmstart")
INPUTS = (*STATE, "eq_active")
MAX_SIZES = 8
FULL_WARNINGS = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class CEngine(Engine):
    """Borrows a `mujoco.batch.Batch` of the right size for every call: no Batch ever serves two threads at once."""

    impl = "c"

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        super().__init__(model, overlay)
        self.c_model = copy.copy(model)
        disable = mujoco.mjtDisableBit
        # Autoreset would put a diverged world back to qpos0 unseen; the midphase reads bounding volumes of walls that
        # are overlaid, and those of the world body cannot be.
        self.c_model.opt.disableflags |= int(disable.mjDSBL_AUTORESET) | int(disable.mjDSBL_MIDPHASE)
        # Not thread-local: XLA's threads drop their Python state after every callback, and the batch with it.
        self._idle: defaultdict[int, deque[Batch]] = defaultdict(deque)

    def carry(self, data: Data) -> jax.Array:
        """What float32 drops of `ADVANCED`, flat: with it a run follows plain MuJoCo in float64 step after step."""
        return jnp.zeros(sum(getattr(data, name).size for name in ADVANCED))

    def renew(self, carried: jax.Array, anew: jax.Array) -> jax.Array:
        return jnp.where(anew, 0.0, carried)

    def exact(self, data: Data) -> dict[str, np.ndarray]:
        rest = np.split(np.asarray(data.engine, float), np.cumsum([np.size(getattr(data, n)) for n in ADVANCED])[:-1])
        out = super().exact(data)
        return out | {name: out[name] + part for name, part in zip(ADVANCED, rest, strict=True)}

    def _integrate(self, world: World, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        # One array in and one out: the callback's cost is per array, not per byte.
        inputs = {name: getattr(data, name) for name in INPUTS} | world.fields
        sizes = {name: value.size for name, value in inputs.items()}
        flat = [value.astype(jnp.float32).reshape(-1) for value in inputs.values()]
        n_advanced = data.engine.size
        out = jax.pure_callback(
            lambda packed: self._step_batch(packed, sizes, n_frames),
            jax.ShapeDtypeStruct((2 * n_advanced + 1,), jnp.float32),
            jnp.concatenate([data.engine, *flat]),
            vmap_method="broadcast_all",
        )
        advanced, rest, full = jnp.split(out, [n_advanced, 2 * n_advanced])
        parts = jnp.split(advanced, np.cumsum([sizes[name] for name in ADVANCED])[:-1])
        fields = {
            name: part.reshape(getattr(data, name).shape) for name, part in zip(ADVANCED, parts, strict=True)
        }
        return data.replace(**fields, engine=rest), full[0] > 0

    def _borrow(self, n_worlds: int) -> Batch:
        try:
            return self._idle[n_worlds].pop()
        except IndexError:
            for n in list(self._idle)[:-MAX_SIZES]:
                self._idle.pop(n, None)
            return Batch(self.c_model, n_worlds)

    def _step_batch(self, packed: np.ndarray, sizes: dict[str, int], n_frames: int) -> np.ndarray:
        """Host side: rows of all inputs side by side, with any leading axes, which are one batch of worlds here."""
        rows = np.asarray(packed)
        lead = rows.shape[:-1]
        rows = rows.reshape(-1, rows.shape[-1])
        batch = self._borrow(len(rows))
        rest, start = 0, sum(sizes[name] for name in ADVANCED)
        for name, size in sizes.items():
            values = rows[:, start : start + size]
            start += size
            if name in self.overlay:
                target = batch.expand(name)
                ids = self.overlay[name]
                target[:, ids] = values.reshape(len(rows), len(ids), *target.shape[2:])
                continue
            target = batch.bind(name).reshape(len(rows), -1)
            target[...] = values
            if name in ADVANCED:
                target += rows[:, rest : rest + size]
                rest += size
        batch.warning[...] = 0
        failed = np.zeros(0, int)
        try:
            batch.step(nstep=n_frames)
        except SimulationError as error:
            failed = error.ids
        exact = np.concatenate([batch.bind(name).reshape(len(rows), -1) for name in ADVANCED], axis=1)
        # A world in which MuJoCo raised kept its old state: NaN makes it the fault that it is.
        exact[failed] = np.nan
        rounded = exact.astype(np.float32)
        full = (batch.warning[:, FULL_WARNINGS, 1] > 0).any(axis=1)
        out = np.concatenate([rounded, exact - rounded, full[:, None]], axis=1, dtype=np.float32, casting="same_kind")
        self._idle[len(rows)].append(batch)
        return out.reshape(*lead, -1)
