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
    """Steps in float64 on all cores; `Data.engine` holds what float32 drops of the fields that a step advances.

    With it a run follows plain MuJoCo step after step. It never exceeds half a unit in the last place of the public
    field that it completes, so those may be changed freely.
    """

    impl = "c"

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        super().__init__(model, overlay)
        self.c_model = copy.copy(model)
        disable = mujoco.mjtDisableBit
        # Autoreset would put a diverged world back to qpos0 unseen; the midphase reads bounding volumes of walls that
        # are overlaid, and those of the world body cannot be.
        self.c_model.opt.disableflags |= int(disable.mjDSBL_AUTORESET) | int(disable.mjDSBL_MIDPHASE)
        # Borrowed for a call, so that no Batch serves two threads at once. Not thread-local: XLA's threads drop their
        # Python state after every callback, and the batch with it.
        self._idle: defaultdict[int, deque[_HostBatch]] = defaultdict(deque)

    def carry(self, data: Data) -> jax.Array:
        return jnp.zeros(sum(getattr(data, name).size for name in ADVANCED))

    def renew(self, carried: jax.Array, anew: jax.Array) -> jax.Array:
        return jnp.where(anew, 0.0, carried)

    def exact(self, data: Data) -> dict[str, np.ndarray]:
        rest = np.split(np.asarray(data.engine, float), np.cumsum([np.size(getattr(data, n)) for n in ADVANCED])[:-1])
        out = super().exact(data)
        return out | {name: out[name] + part for name, part in zip(ADVANCED, rest, strict=True)}

    def advance(self, world: World, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        # One array in and one out: the callback's cost is per array, not per byte.
        inputs = {name: getattr(data, name) for name in INPUTS} | {name: world.fields[name] for name in self.overlay}
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
        fields = {name: part.reshape(getattr(data, name).shape) for name, part in zip(ADVANCED, parts, strict=True)}
        return data.replace(**fields, engine=rest), full[0] > 0

    def _step_batch(self, packed: np.ndarray, sizes: dict[str, int], n_frames: int) -> np.ndarray:
        """Host side: one row per world, of any leading axes, with all inputs side by side."""
        packed = np.asarray(packed)
        rows = packed.reshape(-1, packed.shape[-1])
        host = self._borrow(len(rows))
        out = host.step(rows, sizes, n_frames)
        self._idle[len(rows)].append(host)
        return out.reshape(*packed.shape[:-1], -1)

    def _borrow(self, n_worlds: int) -> _HostBatch:
        try:
            return self._idle[n_worlds].pop()
        except IndexError:
            for n in list(self._idle)[:-MAX_SIZES]:
                self._idle.pop(n, None)
            return _HostBatch(self.c_model, self.overlay, n_worlds)


class _HostBatch:
    """A `mujoco.batch.Batch` and the fields last written to it."""

    def __init__(self, model: mujoco.MjModel, overlay: Overlay, n_worlds: int):
        self.batch = Batch(model, n_worlds)
        self._fields = [(self.batch.expand(name), ids) for name, ids in overlay.items()]
        self._written: np.ndarray | None = None

    def step(self, rows: np.ndarray, sizes: dict[str, int], n_frames: int) -> np.ndarray:
        batch, n_worlds = self.batch, len(rows)
        n_advanced = sum(sizes[name] for name in ADVANCED)
        rest, start = 0, n_advanced
        for name in INPUTS:
            target = batch.bind(name).reshape(n_worlds, -1)
            size = sizes[name]
            target[...] = rows[:, start : start + size]
            start += size
            if name in ADVANCED:
                target += rows[:, rest : rest + size]
                rest += size
        self._write_fields(rows[:, start:])
        batch.warning[...] = 0
        failed: np.ndarray | None = None
        try:
            batch.step(nstep=n_frames)
        except SimulationError as error:
            failed = error.ids
        out = np.empty((n_worlds, 2 * n_advanced + 1), np.float32)
        start = 0
        for name in ADVANCED:
            exact = batch.bind(name).reshape(n_worlds, -1)
            end = start + sizes[name]
            out[:, start:end] = exact
            np.subtract(
                exact, out[:, start:end], out=out[:, n_advanced + start : n_advanced + end], casting="same_kind"
            )
            start = end
        if failed is not None:  # MuJoCo raised and kept the old state: NaN makes it the fault that it is
            out[failed, :-1] = np.nan
        out[:, -1] = (batch.warning[:, FULL_WARNINGS, 1] > 0).any(axis=1)
        return out

    def _write_fields(self, rows: np.ndarray) -> None:
        """Writes the overlay where it changed, which is where a world was reset."""
        if self._written is None:
            changed = np.ones(len(rows), bool)
        else:
            changed = (rows != self._written).any(axis=1)
            if not changed.any():
                return
        self._written = rows.copy()
        start = 0
        for target, ids in self._fields:
            shape = (len(ids), *target.shape[2:])
            size = int(np.prod(shape))
            values = rows[changed, start : start + size].reshape(-1, *shape)
            target[np.ix_(changed, ids)] = values
            start += size
