"""The engine impl="c": MuJoCo's C engine behind the same jitted, vmapped step, through one host callback."""

from __future__ import annotations

import copy
import logging
import os
from collections import defaultdict, deque
from functools import partial
from itertools import pairwise
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.experimental.buffer_callback import buffer_callback
from mujoco.batch import Batch, SimulationError

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import STATE, Engine
from maax_mjx.physics.fields import Fields, Overlay

ADVANCED = ("time", "qpos", "qvel", "qacc_warmstart")
INPUTS = (*STATE, "eq_active")
MAX_SIZES = 8
WILD, WILD_MEAN = 40.0, 20.0
"""Metres or radians per second at the end of a step, and in its mean, that hardly anything reaches unless a solver
diverges: agents reach 10 and 10."""
AGAIN = 8
"""Worlds that are stepped again together."""
CG_ITERATIONS = 300
THREADS_PER_DEVICE = 4
Rows = dict[str, np.ndarray]
"""Arrays (n_worlds, size) by name."""

FULL_WARNINGS = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class CEngine(Engine):
    """Steps in float64 on all cores; `Data.engine` holds what float32 drops of the fields that a step advances.

    With it a run follows plain MuJoCo step after step. It never exceeds half a unit in the last place of the public
    field that it completes, so those may be changed freely.

    MuJoCo's Newton solver factorises once and then updates, and in a jam of many boxes with small frictions as Baker
    et al. have them it can diverge, whatever its iterations: a body leaves at 1,000 rad/s. Worlds with wild speeds
    are stepped again by conjugate gradients, which find the right answer there.
    """

    impl = "c"

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        super().__init__(model, overlay)
        _log_warnings()
        self.c_model = copy.copy(model)
        disable = mujoco.mjtDisableBit
        # Autoreset would put a diverged world back to qpos0 unseen; the midphase reads bounding volumes of walls that
        # are overlaid, and those of the world body cannot be.
        self.c_model.opt.disableflags |= int(disable.mjDSBL_AUTORESET) | int(disable.mjDSBL_MIDPHASE)
        # Borrowed for a call, so that no Batch serves two threads at once. Not thread-local: XLA's threads drop their
        # Python state after every callback, and the batch with it.
        self._idle: defaultdict[int, deque[_HostBatch]] = defaultdict(deque)
        self._far = WILD_MEAN * model.opt.timestep
        self._careful_model = copy.copy(self.c_model)
        self._careful_model.opt.solver = int(mujoco.mjtSolver.mjSOL_CG)
        self._careful_model.opt.iterations = CG_ITERATIONS
        self._careful: deque[_HostBatch] = deque()

    def check_devices(self, n_devices: int) -> None:
        # Callbacks of several devices at once take XLA's threads from each other, until none is left to go on.
        threads = int(os.environ.get("NPROC") or os.cpu_count() or 1)
        if n_devices > 1 and threads < THREADS_PER_DEVICE * n_devices:
            raise ValueError(
                f"devices: got {n_devices} with impl='c', which needs {THREADS_PER_DEVICE * n_devices} threads for "
                f"them and has {threads}; takes one device, which uses all cores already, or "
                f"NPROC={THREADS_PER_DEVICE * n_devices} in the environment before JAX starts"
            )

    def carry(self, data: Data) -> jax.Array:
        return jnp.zeros(sum(getattr(data, name).size for name in ADVANCED))

    def renew(self, carried: jax.Array, begins: jax.Array) -> jax.Array:
        return jnp.where(begins, 0.0, carried)

    def exact(self, data: Data) -> dict[str, np.ndarray]:
        rest = np.split(
            np.asarray(self._carried(data), float), np.cumsum([np.size(getattr(data, n)) for n in ADVANCED])[:-1]
        )
        out = super().exact(data)
        return out | {name: out[name] + part for name, part in zip(ADVANCED, rest, strict=True)}

    def step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        state = {name: getattr(data, name) for name in INPUTS}
        rest = self._carried(data)
        fields = {name: fields[name] for name in self.overlay}
        results = {name: jax.ShapeDtypeStruct(state[name].shape, state[name].dtype) for name in ADVANCED}
        results["engine"] = jax.ShapeDtypeStruct(rest.shape, rest.dtype)
        results["full"] = jax.ShapeDtypeStruct((), bool)
        # Not jax.pure_callback: that copies to and fro through device_put, for 0.1 to 0.2 ms a call.
        call = buffer_callback(partial(self._step_batch, n_frames), results, vmap_method="broadcast_all")
        out = call(state, fields, rest)
        full = out.pop("full")
        return data.replace(**out), full

    def _carried(self, data: Data) -> jax.Array:
        """What the engine carries; nothing yet in a state that another engine made."""
        return jnp.asarray(data.engine) if isinstance(data.engine, jax.Array | np.ndarray) else self.carry(data)

    def _step_batch(self, n_frames: int, context: Any, out: Any, state: Any, fields: Any, rest: Any) -> None:
        """Host side. All arguments have the same leading axes, of as many worlds as there are."""
        n_worlds = prod(state["time"].shape)

        def rows(buffers: dict[str, Any]) -> Rows:
            return {name: np.asarray(buffer).reshape(n_worlds, -1) for name, buffer in buffers.items()}

        host = self._borrow(n_worlds)
        args = rows(out), rows(state), rows(fields), rows({"engine": rest})["engine"]
        host.step(*args, n_frames)
        self._idle[n_worlds].append(host)
        wild = self._wild(*args[:2], n_frames)
        if wild.size:
            self._step_again(wild, *args, n_frames)

    def _wild(self, out: Rows, state: Rows, n_frames: int) -> np.ndarray:
        """The rows with wild speeds, or with NaN."""
        speed, way, far = out["qvel"], out["qpos"] - state["qpos"], self._far * n_frames
        # Of the whole batch first: that takes a tenth of the time.
        if speed.min() > -WILD and speed.max() < WILD and -far < way.min() and way.max() < far:
            return np.zeros(0, int)
        return np.flatnonzero(~((np.abs(speed) < WILD).all(axis=1) & (np.abs(way) < far).all(axis=1)))

    def _step_again(self, wild: np.ndarray, out: Rows, state: Rows, fields: Rows, rest: np.ndarray, n: int) -> None:
        """Replaces the results of some worlds by those of the careful solver."""
        try:
            host = self._careful.pop()
        except IndexError:
            host = _HostBatch(self._careful_model, self.overlay, AGAIN)
        for start in range(0, len(wild), AGAIN):
            ids = wild[start : start + AGAIN]
            filled = np.resize(ids, AGAIN)
            new = {name: values[filled] for name, values in out.items()}
            before, rows = ({name: values[filled] for name, values in part.items()} for part in (state, fields))
            host.step(new, before, rows, rest[filled], n)
            for name, values in new.items():
                out[name][ids] = values[: len(ids)]
        self._careful.append(host)

    def _borrow(self, n_worlds: int) -> _HostBatch:
        try:
            return self._idle[n_worlds].pop()
        except IndexError:
            for n in list(self._idle)[:-MAX_SIZES]:
                self._idle.pop(n, None)
            return _HostBatch(self.c_model, self.overlay, n_worlds)


def _log_warnings() -> None:
    """Sends MuJoCo's warnings to the logger "mujoco", as debug messages, unless the user has a handler of their own.

    Without one MuJoCo writes MUJOCO_LOG.TXT into the working directory. Nothing is lost: a world that MuJoCo warns
    about is a fault, which metrics count.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logging.getLogger("mujoco").debug)


class _HostBatch:
    """A `mujoco.batch.Batch` and the fields last written to it. Arrays are (n_worlds, size)."""

    def __init__(self, model: mujoco.MjModel, overlay: Overlay, n_worlds: int):
        self.batch = Batch(model, n_worlds)
        self._state = {name: self.batch.bind(name).reshape(n_worlds, -1) for name in INPUTS}
        ends = np.cumsum([0, *(self._state[name].shape[1] for name in ADVANCED)]).tolist()
        self._columns = {name: slice(*ends[i : i + 2]) for i, name in enumerate(ADVANCED)}
        self._wide = np.empty((n_worlds, ends[-1]))
        self._fields = {name: (self.batch.expand(name), _runs(ids)) for name, ids in overlay.items()}
        self._warning = self.batch.warning
        self._full = self._warning[:, FULL_WARNINGS[0], 1], self._warning[:, FULL_WARNINGS[1], 1]
        self._written: dict[str, bytes] = {}

    def step(
        self,
        out: Rows,
        state: Rows,
        fields: Rows,
        rest: np.ndarray,
        n_frames: int,
    ) -> None:
        batch = self.batch
        # All that is advanced in one array, added in one type: NumPy is several times slower otherwise.
        wide, columns = self._wide, self._columns
        for name in INPUTS:
            (wide[:, columns[name]] if name in columns else self._state[name])[...] = state[name]
        wide += rest.astype(float)
        for name, part in columns.items():
            self._state[name][...] = wide[:, part]
        for name, values in fields.items():
            self._write_field(name, values)
        self._warning[...] = 0
        failed: np.ndarray | None = None
        try:
            batch.step(nstep=n_frames)
        except SimulationError as error:
            failed = error.ids
        for name, part in columns.items():
            wide[:, part] = self._state[name]
        if failed is not None:  # MuJoCo raised and kept the old state: NaN makes it the fault that it is
            wide[failed] = np.nan
        public = wide.astype(np.float32)
        for name, part in columns.items():
            out[name][...] = public[:, part]
        out["engine"][...] = wide - public.astype(float)
        out["full"][:, 0] = np.logical_or(*self._full)

    def _write_field(self, name: str, values: np.ndarray) -> None:
        """Writes an overlaid field when it changed, which is when a world was reset or a lock was."""
        new = values.tobytes()
        if new == self._written.get(name):
            return
        self._written[name] = new
        target, runs = self._fields[name]
        values = values.reshape(len(values), -1, *target.shape[2:])
        # All of it: to find the worlds that differ takes longer.
        for rows, columns in runs:
            target[:, rows] = values[:, columns]


def _runs(ids: np.ndarray) -> list[tuple[slice, slice]]:
    """Consecutive ids as slices, and where they are among all; slices are written several times faster."""
    ends = [0, *(np.flatnonzero(np.diff(ids) != 1) + 1).tolist(), len(ids)]
    return [(slice(ids[a], ids[b - 1] + 1), slice(a, b)) for a, b in pairwise(ends) if a < b]
