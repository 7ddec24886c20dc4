"""The host side of the engine "c": MuJoCo's batches, which a program calls by the number of their model."""

from __future__ import annotations

import copy
import logging
from collections import defaultdict, deque
from collections.abc import Sequence
from hashlib import sha1
from itertools import pairwise

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from maax_mjx.physics.engine import STATE
from maax_mjx.physics.fields import Overlay

ADVANCED = ("time", "qpos", "qvel", "qacc_warmstart")
"""Fields of `Data` that a step advances."""
INPUTS = (*STATE, "eq_active")
"""Fields of `Data` that a step reads."""
MAX_SIZES = 8
Rows = dict[str, np.ndarray]
"""Arrays (n_worlds, size) by name."""

FULL_WARNINGS = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class HostStepper:
    """Steps any number of worlds of a model in float64 on all cores.

    Args:
        model: the compiled model; kept unchanged.
        overlay: the rows of its fields in which worlds differ.
    """

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        _log_warnings()
        self.overlay = overlay
        self.field_names = sorted(overlay)
        self.model = _unseen(model)
        # Borrowed for a call, so that no Batch serves two threads at once. Not thread-local: XLA's threads drop their
        # Python state after every call, and the batch with it.
        self._idle: defaultdict[int, deque[_HostBatch]] = defaultdict(deque)

    def forget(self) -> None:
        """Frees the memory of batches, which are made again when they are needed."""
        self._idle.clear()

    def called(self, n: int, out: list[np.ndarray], args: list[np.ndarray]) -> None:
        """Host side of `step`, of as many worlds as the arrays have rows: fills `out`; `n` are the physics steps."""
        n_worlds = args[0].size

        def rows(names: Sequence[str], arrays: Sequence[np.ndarray]) -> Rows:
            return {name: x.reshape(n_worlds, -1) for name, x in zip(names, arrays, strict=True)}

        results, ends = rows((*ADVANCED, "engine", "full"), out), len(INPUTS)
        state, fields = rows(INPUTS, args[:ends]), rows(self.field_names, args[ends:-1])
        host = self._borrow(n_worlds)
        host.step(results, state, fields, args[-1].reshape(n_worlds, -1), n)
        self._idle[n_worlds].append(host)

    def _borrow(self, n_worlds: int) -> _HostBatch:
        try:
            return self._idle[n_worlds].pop()
        except IndexError:
            for n in list(self._idle)[:-MAX_SIZES]:
                self._idle.pop(n, None)
            return _HostBatch(self.model, self.overlay, n_worlds)


def number_of(model: mujoco.MjModel, overlay: Overlay) -> int:
    """Returns a number of the model and its overlay, the same in every process: programs know the engine by it."""
    model = _unseen(model)
    written = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, written)
    digest = sha1(written.tobytes())
    for name in sorted(overlay):
        digest.update(name.encode() + np.asarray(overlay[name], np.int64).tobytes())
    return int.from_bytes(digest.digest()[:8], "little", signed=True)


def _unseen(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a copy with what batches need: autoreset would put a diverged world back to qpos0 unseen.

    The midphase reads bounding volumes of walls that are overlaid, and those of the world body cannot be. MuJoCo 4.0's
    Newton solver diverges with sparse matrices, which it takes by itself from 60 degrees of freedom on (docs/upstream).
    """
    model, disable = copy.copy(model), mujoco.mjtDisableBit
    model.opt.disableflags |= int(disable.mjDSBL_AUTORESET) | int(disable.mjDSBL_MIDPHASE)
    model.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
    return model


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
        with np.errstate(over="ignore"):  # what is beyond float32 is a fault, which the env finds
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
