"""Worlds with faults, kept on disk: what happened in them last, to be looked at and stepped again."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.experimental import io_callback

from maax_mjx.common.keys import as_key, keyless
from maax_mjx.common.recorded import texts_of
from maax_mjx.common.version import VERSION
from maax_mjx.common.whole import whole
from maax_mjx.core.diagnosis import Diagnosis, diagnose
from maax_mjx.core.env import Environment
from maax_mjx.core.export import to_mjcf
from maax_mjx.core.identity import about_environment, difference
from maax_mjx.core.state import State, plain
from maax_mjx.parallel.episodes import WorldsState, without_engine
from maax_mjx.parallel.recording import KEPT, Recording, filled, read, strip, write

MOMENTS = 8
"""States and actions of a world that are kept, up to the one of the fault."""
MOST = 16
"""Faults in a folder at most: more of them tell nothing new, and would fill a disk."""
AT_ONCE = 4
"""Worlds that are kept of those with faults in the same step."""


class Recent(struct.PyTreeNode):
    """What happened last in the worlds of a batch.

    Attributes:
        index: (n_worlds,) int32, the worlds' own.
        states: stripped states, (n_worlds, MOMENTS, ...), the latest last.
        action: what was done in them.
        episode_return: (n_worlds, MOMENTS, n_agents) reward before.
    """

    index: jax.Array
    states: State
    action: Any
    episode_return: jax.Array


class FaultKeeper:
    """Keeps worlds with faults in a folder: `0.npz`, `1.npz`, ..., and beside them `0.xml`, ... for plain MuJoCo.

    Args:
        env: the environment.
        folder: the folder, which is made where it is not there; faults that are there already count.

    Raises:
        ValueError: a folder that cannot be made.
    """

    def __init__(self, env: Environment, folder: str | Path):
        self.env = env
        self.folder = _folder(folder)
        self._next = 1 + max(self._numbers, default=-1)
        self._lock = Lock()
        self._pool = ThreadPoolExecutor(1, "maax-faults")
        self._writing: list[Future] = []

    def begin(self, index: jax.Array, states: WorldsState) -> Recent:
        """Returns the memory of worlds (n,) that begin."""
        action = jax.tree.map(
            lambda x: jnp.zeros((*index.shape, *x.shape), x.dtype),
            jax.eval_shape(self.env.sample_action, jax.random.key(0)),
        )
        parts = strip(states), action, states.episode_return
        return Recent(index, *jax.tree.map(lambda x: jnp.repeat(x[:, None], MOMENTS, axis=1), parts))

    def watch(self, before: WorldsState, action: Any, fault: jax.Array) -> Recent:
        """Returns the memory with one more step, and hands over what is to be kept.

        Args:
            before: states of worlds (n,) before the step.
            action: what was done in them.
            fault: (n,) bool, whether the step was a fault.
        """
        recent: Recent = before.recent
        parts = strip(before), action, before.episode_return
        old = recent.states, recent.action, recent.episode_return
        # Policies may give whole numbers of another type than the space's.
        now = jax.tree.map(lambda x, new: jnp.concatenate([x[:, 1:], new[:, None].astype(x.dtype)], axis=1), old, parts)
        recent = Recent(recent.index, *now)

        def hand_over() -> None:
            astray, picked = jax.lax.top_k(fault.astype(jnp.int32), min(AT_ONCE, len(fault)))
            episode = before.counts["episodes"]
            kept = jax.tree.map(lambda x: x[picked], (recent, keyless(plain(before)), episode))
            io_callback(self._keep, None, astray, *kept)

        jax.lax.cond(fault.any(), hand_over, lambda: None)
        return recent

    def files(self) -> list[Path]:
        """Returns the files of the faults kept so far, once they are written."""
        jax.effects_barrier()
        for one in self._writing:
            one.result()
        return [self.folder / f"{number}.npz" for number in sorted(self._numbers)]

    @property
    def _numbers(self) -> list[int]:
        """Numbers of the faults in the folder."""
        return [int(file.stem) for file in self.folder.glob("*.npz") if file.stem.isdecimal()]

    def _keep(self, astray: Any, recent: Any, before: Any, episode: Any) -> None:
        """Host side: takes copies, and has them written beside the program, which a callback holds up."""
        astray, recent, before, episode = jax.tree.map(np.array, (astray, recent, before, episode))
        for i in np.flatnonzero(astray).tolist():
            one, state = jax.tree.map(lambda x, i=i: x[i], (recent, before))
            with self._lock:
                if self._next >= MOST:
                    return
                number, self._next = self._next, self._next + 1
                self._writing.append(self._pool.submit(self._write, number, one, state, int(episode[i])))

    def _write(self, number: int, recent: Recent, state: State, episode: int) -> None:
        env, step = self.env, recent.states.step
        # Of the running episode alone: steps that count up to the last one.
        n = next((k for k in range(1, MOMENTS) if step[-1 - k] != step[-1] - k), MOMENTS)
        recording = Recording(*jax.tree.map(lambda x: x[-n:, None], (recent.states, recent.episode_return)))
        about = about_environment(env)
        meta = {
            "maax_mjx": VERSION,
            "env": about.get("game", ""),
            "overrides": texts_of(about.get("config", {})),
            "about": about,
            "fault": {
                "world": int(recent.index),
                "episode": episode,
                "step": int(step[-1]),
                "engine": env.base.engine.impl,
            },
        }
        parts = {
            "actions": jax.tree.map(lambda x: x[-n:], recent.action),
            "state": without_engine(state),
            "engine": state.data.engine,
        }
        write(self.folder / f"{number}.npz", meta, recording, parts)
        with whole(self.folder / f"{number}.xml") as part:
            part.write_text(to_mjcf(env, state))


class Fault(NamedTuple):
    """A world with a fault, as `keep_faults` keeps it.

    Attributes:
        env: the environment.
        about: the "world", its "episode", the "step" of the fault, and the "engine".
        recording: the world's last states, with the leading axes (n_frames, 1).
        actions: what was done in them, (n_frames, ...).
        state: the last of them, whole: a step from it with `action` was the fault.
    """

    env: Environment
    about: dict[str, Any]
    recording: Recording
    actions: Any
    state: State

    def __repr__(self) -> str:
        about = ", ".join(f"{name} {value}" for name, value in self.about.items())
        return f"<Fault: {about}; {len(self.recording.states.step)} frames>"

    def state_at(self, moment: int = -1) -> State:
        """Returns a state that steps: the last one, or one of those before.

        Args:
            moment: index of a frame of the recording; negative ones count from the last.

        Raises:
            ValueError: no such frame.
        """
        i = self._index(moment)
        if i == len(self.recording.states.step) - 1:
            return self.state
        kept = {name: jax.tree.map(lambda x: x[i, 0], getattr(self.recording.states, name)) for name in KEPT}
        data = kept.pop("data")
        return self.state.replace(**kept, data=data.replace(engine=self.env.base.engine.carry(data)))

    def action_at(self, moment: int = -1) -> Any:
        """Returns what was done in a state; `moment` as in `state_at`."""
        i = self._index(moment)
        return jax.tree.map(lambda x: x[i], self.actions)

    def diagnose(self, moment: int = -1) -> Diagnosis:
        """Makes the last step again, or one before it, physics step by physics step; `moment` as in `state_at`."""
        return diagnose(self.env, self.state_at(moment), self.action_at(moment))

    def _index(self, moment: int) -> int:
        n = len(self.recording.states.step)
        if isinstance(moment, bool) or not isinstance(moment, int) or not -n <= moment < n:
            raise ValueError(f"moment: got {moment!r}; takes an index of one of the {n} frames")
        return moment % n


def load_fault(path: str | Path, env: Environment) -> Fault:
    """Loads a world with a fault.

    Args:
        path: a file of `Worlds(..., keep_faults=folder)`.
        env: its environment, on any engine.

    Raises:
        ValueError: another file, or one of another environment.
    """
    path = Path(path)
    takes = "takes a file of keep_faults"
    meta, arrays = read(path, takes)
    if "fault" not in meta:
        raise ValueError(f"file: got {path}, which has a rollout without faults; {takes}")
    if (made := env.made_from) is not None and meta["env"] and meta["env"] != made.name:
        raise ValueError(f"env: got {made}, and {path} is of {meta['env']}; takes the environment of the file")
    if "about" in meta and (other := difference(meta["about"], about_environment(env), wrappers=False)):
        raise ValueError(f"env: got another one than {path} is of, {other}; takes the environment of the file")
    shape = env.state_shape
    returns = jax.ShapeDtypeStruct(shape.reward.shape, shape.reward.dtype)
    recording = filled(path, meta, arrays, Recording(strip(shape), returns), leading=2)
    action = jax.eval_shape(env.sample_action, jax.random.key(0))
    actions = filled(path, meta, arrays, {"actions": action}, leading=1)["actions"]
    bare = without_engine(shape)
    state = filled(path, meta, arrays, {"state": jax.eval_shape(keyless, bare)}, leading=0)["state"]
    state = jax.tree.map(as_key, state, bare)
    if meta["fault"]["engine"] == env.base.engine.impl:
        carried = filled(path, meta, arrays, {"engine": shape.data.engine}, leading=0)["engine"]
    else:
        carried = env.base.engine.carry(state.data)
    return Fault(env, meta["fault"], recording, actions, state.replace(data=state.data.replace(engine=carried)))


def _folder(folder: Any) -> Path:
    if not isinstance(folder, str | Path) or not str(folder):
        raise ValueError(f"keep_faults: got {folder!r}; takes a folder")
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"keep_faults: got {folder}, where no folder can be made ({error.strerror}); takes the path of a folder"
        ) from None
    return path
