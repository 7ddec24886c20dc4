"""States in all forms in which users have them, as the frames of a few worlds on the host."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from maax_mjx.common.checks import check_not_donated
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State, check_fits
from maax_mjx.parallel import Recording, WorldsState
from maax_mjx.parallel.recording import joined, strip

Picked = int | Sequence[int] | None


class Film(NamedTuple):
    """Some worlds over time, on the host.

    Attributes:
        states: by frame and world.
        returns: by frame and world, (n_agents,) reward since the episode began; None where it is not known.
        times: (n_frames,) seconds since the first frame.
    """

    states: list[list[State]]
    returns: list[list[np.ndarray | None]]
    times: np.ndarray

    @property
    def edge(self) -> float:
        """Metres: the edge of the largest floor."""
        return max(float(state.world.plan.floor_size) for frame in self.states for state in frame)

    @property
    def rate(self) -> float:
        """Frames per second; of a single one, as many as one likes."""
        n = len(self.times)
        return float((n - 1) / self.times[-1]) if n > 1 else np.inf

    def at(self, indices: Iterable[int]) -> Film:
        """The film of some of the frames."""
        chosen = list(indices)
        return Film([self.states[i] for i in chosen], [self.returns[i] for i in chosen], self.times[chosen])


def film(env: Environment, states: Any, worlds: Picked) -> Film:
    """The frames of some worlds.

    Args:
        env: whose states they are.
        states: a `Recording`; a list of states of single worlds or of batches; or one state with the leading axis
            (n_frames,) or axes (n_frames, n_worlds).
        worlds: which of a batch; None is the first one, or all of a recording.

    Raises:
        ValueError: anything else, no frames, or indices out of range.
        RuntimeError: states that were donated to a later step.
    """
    known: np.ndarray | None = None
    if isinstance(states, Recording):
        chosen = list(range(states.states.step.shape[1])) if worlds is None else worlds
        stacked, known = _stacked(states.states, chosen, states.episode_return)
    elif isinstance(states, State):
        if np.ndim(states.step) not in (1, 2):
            raise ValueError(
                f"states: got one state with the leading axes {np.shape(states.step)}; takes a list of states, or one "
                "with (n_frames,) or (n_frames, n_worlds)"
            )
        stacked, known = _stacked(states, worlds, getattr(states, "episode_return", None))
        if np.ndim(states.step) == 1 and len(states.step) > 1 and (stacked.step == stacked.step[0]).all():
            raise ValueError(
                f"states: got {len(states.step)} frames, all at step {int(stacked.step[0, 0])}; takes moments of one "
                "world, in a list where they are meant to be at one step, or [states] for a batch at one moment"
            )
    else:
        stacked, known = _listed(states, worlds)
    n_frames, n_worlds = stacked.step.shape
    if not n_frames or not n_worlds:
        raise ValueError(f"states: got {n_frames} frames of {n_worlds} worlds; takes at least one")
    check_fits(stacked, env.state_shape, leading=2)
    returns = _summed(stacked) if known is None else np.where(stacked.step[..., None] == 0, 0.0, known)
    split = [[jax.tree.map(lambda x, t=t, w=w: x[t, w], stacked) for w in range(n_worlds)] for t in range(n_frames)]
    sums = [[None if np.isnan(row).any() else row for row in frame] for frame in returns]
    return Film(split, sums, _times(np.asarray(stacked.step), env.base.dt))


def one_time(env: Environment, state: Any, worlds: Picked) -> Film:
    """The single frame of some worlds of a state, of one world or a batch.

    Raises:
        ValueError: something else, or indices out of range.
    """
    if not isinstance(state, State):
        raise ValueError(f"state: got {type(state).__name__}; takes a state, as reset and step give it")
    return film(env, [state], worlds)


def paced(times: np.ndarray, fps: float) -> list[int]:
    """The frames that are at least 1 / fps seconds apart, and the last one."""
    kept, last = [], -np.inf
    for i, time in enumerate(times):
        # Frames come at multiples of the time step, which float does not hold exactly.
        if time - last >= 1 / fps - 1e-6:
            kept.append(i)
            last = time
    return kept if kept[-1] == len(times) - 1 else [*kept, len(times) - 1]


def _stacked(states: State, worlds: Picked, returns: Any) -> tuple[State, np.ndarray | None]:
    """Some worlds, on the host, of states with the leading axes (n_frames,) or (n_frames, n_worlds)."""
    check_not_donated(states.step)
    parts = (strip(states), returns)
    if np.ndim(states.step) == 1:
        _only_one(worlds)
        parts = jax.tree.map(lambda x: x[:, None], parts)
    else:
        index = chosen_worlds(worlds, states.step.shape[1])
        parts = jax.tree.map(lambda x: x[:, index], parts)
    return jax.device_get(parts)


def _listed(states: Any, worlds: Picked) -> tuple[State, np.ndarray | None]:
    if isinstance(states, str | bytes | dict) or not isinstance(states, Iterable):
        raise ValueError(
            f"states: got {type(states).__name__}; takes a list of states, one state with a leading axis of time, or "
            "what maax.record gives"
        )
    frames, states = [], list(states)
    for state in states:
        if not isinstance(state, State):
            raise ValueError(f"states: got a list with {type(state).__name__}; takes states, as reset and step give")
        frames.append(select_worlds(state, worlds))
    if not frames:
        raise ValueError("states: got an empty list; takes at least one state")
    alone = {not np.shape(state.step) for state in states}
    if len(alone) > 1 or len({frame[0].step.shape for frame in frames}) > 1:
        raise ValueError("states: got states of different numbers of worlds; takes all of one batch")
    if any(frame[1] is None for frame in frames):
        frames = [(frame[0], None) for frame in frames]
    return joined(frames)


def select_worlds(state: State, worlds: Picked) -> tuple[State, np.ndarray | None]:
    """Some worlds of a state on the host, and their `episode_return` if it has any, with the leading axis (n,)."""
    check_not_donated(state.step)
    shape = np.shape(state.step)
    parts = (strip(state), state.episode_return if isinstance(state, WorldsState) else None)
    if not shape:
        _only_one(worlds)
        return jax.tree.map(lambda x: np.asarray(x)[None], jax.device_get(parts))
    at = np.unravel_index(chosen_worlds(worlds, int(np.prod(shape))), shape)
    return jax.device_get(_take(parts, at))


@jax.jit
def _take(tree: Any, at: tuple[Any, ...]) -> Any:
    return jax.tree.map(lambda x: x[at], tree)


def chosen_worlds(worlds: Picked, n: int, name: str = "worlds") -> np.ndarray:
    """Indices (k,) of worlds among n.

    Args:
        worlds: an index or several; None is the first one.
        n: how many worlds there are.
        name: of the argument, for the message.

    Raises:
        ValueError: not an index, or out of range.
    """
    given = 0 if worlds is None else worlds
    index = np.atleast_1d(np.asarray(given))
    whole = index.dtype.kind in "iu" and index.ndim == 1 and index.size
    if not whole or not ((index >= -n) & (index < n)).all():
        raise ValueError(f"{name}: got {worlds!r}; takes a number below {n}, or a list of such")
    return index % n


def _only_one(worlds: Picked) -> None:
    if worlds is not None and np.atleast_1d(np.asarray(worlds)).tolist() != [0]:
        raise ValueError(f"worlds: got {worlds!r}; the states are of a single world and take None")


def _summed(states: State) -> np.ndarray:
    """(n_frames, n_worlds, n_agents) reward since the episode began; NaN where a step or the beginning is missing."""
    sums = np.full(states.reward.shape, np.nan)
    for t, (step, reward) in enumerate(zip(states.step, states.reward, strict=True)):
        begun = step <= 1
        follows = (step == states.step[t - 1] + 1) if t else np.zeros_like(begun)
        before = np.where(begun[:, None], 0.0, sums[t - 1] if t else np.nan)
        # A reset comes with the reward of the step that ended the episode before it.
        own = np.where((step == 0)[:, None], 0.0, reward)
        sums[t] = np.where((begun | follows)[:, None], before + own, np.nan)
    return sums


def _times(step: np.ndarray, dt: float) -> np.ndarray:
    """(n_frames,) seconds since the first; over a reset, as long as between the others."""
    gaps = np.diff(step.astype(int), axis=0)
    usual = int(np.median(gaps[gaps > 0])) if (gaps > 0).any() else 1
    steps = [int(row[row > 0].max()) if (row > 0).any() else usual for row in gaps]
    return np.concatenate([[0], np.cumsum(steps)]) * dt
