"""Recording a few worlds of a large batch while it plays."""

from __future__ import annotations

from typing import Any

import jax

from maax_mjx.common.checks import check_count, check_key
from maax_mjx.parallel import Recording, Worlds, WorldsState
from maax_mjx.parallel.policy import Playable, Policy
from maax_mjx.viewer.film import Picked, chosen_worlds, select_worlds

FPS = 30


def record(
    worlds: Worlds,
    states: WorldsState,
    policy: Policy | Playable,
    n_steps: int,
    *args: Any,
    show: Picked = None,
    every: int | None = None,
    key: jax.Array | None = None,
    memory: Any = None,
    per_world: tuple[Any, ...] = (),
) -> tuple[WorldsState, Recording]:
    """Steps all worlds as `Worlds.rollout` does, and keeps what pictures need of a few.

    However many worlds play, memory is needed for those that are shown alone: 2 to 16 kB a world and frame, on the
    host.

    Args:
        worlds: the batch.
        states: from its `reset`, `step` or `rollout`; donated.
        policy: see `Worlds.rollout`.
        n_steps: how many env steps, at least; as many more as fill the last frame.
        args: what the policy gets besides.
        show: which worlds to keep: an index or several; None is the first.
        every: env steps from frame to frame; None makes 30 frames a second.
        key: where the policy's keys follow from; None is `jax.random.key(0)`.
        memory, per_world: see `Worlds.rollout`.

    Returns:
        The states after the last step, and the recording, whose first frame is that of `states`.

    Raises:
        ValueError: an argument out of its range, or what `Worlds.rollout` refuses.
    """
    if not isinstance(worlds, Worlds):
        raise ValueError(f"worlds: got {type(worlds).__name__}; takes maax.Worlds(env, n_worlds)")
    n_steps = check_count("n_steps", n_steps, minimum=1)
    every = max(1, round(1 / (FPS * worlds.env.base.dt))) if every is None else check_count("every", every, minimum=1)
    chosen_worlds(show, worlds.n_worlds, name="show")
    if not isinstance(states, WorldsState):
        raise ValueError(f"states: got {type(states).__name__}; takes what the worlds' reset, step or rollout gives")
    key = jax.random.key(0) if key is None else key
    check_key("key", key)
    frames = [select_worlds(states, show)]
    for i in range(-(-n_steps // every)):
        now = jax.random.fold_in(key, i)
        states, kept = worlds.rollout(states, policy, every, *args, key=now, memory=memory, per_world=per_world)
        memory = kept.get("memory")
        frames.append(select_worlds(states, show))
    return states, Recording.of(frames)
