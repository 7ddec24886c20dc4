"""Episodes of a batch of worlds, as pure functions of any number of worlds: beginning, stepping and resetting them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.arrays import strong
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import FIELDS, State, plain, summary

LEAST_CHUNK, CHUNKS = 64, 16
"""Worlds per chunk in which next episodes are drawn: at least 64, and a sixteenth of the batch."""
RESULTS = ("reward", "terminated", "truncated", "metrics", "params")
"""Fields of a state that stay where an episode ends: what the step came to, and the ranges of the world."""


class Upcoming(struct.PyTreeNode):
    """The beginnings of the next episodes, drawn ahead of time.

    Attributes:
        state: the first states of the next episodes, without `RESULTS`.
        stale: (n_worlds,) bool, whether a beginning is used up and must be drawn.
    """

    state: State
    stale: jax.Array


class Visited(struct.PyTreeNode):
    """States from the middle of episodes, with which episodes may begin instead of what was drawn.

    Attributes:
        state: (k, ...) the states: rows of a batch's states, as they were at any step.
        index: (n_worlds,) int32, the state with which a world would begin.
        taken: (n_worlds,) bool, whether it does if its episode ends at this step.
    """

    state: State
    index: jax.Array
    taken: jax.Array


class WorldsState(State):
    """The states of a batch; every field of `State` has a leading axis (n_worlds,).

    Where a step ended an episode, `obs`, `data`, `world`, `step`, `key` and `mechanics` are the next
    episode's first, while `reward`, `terminated`, `truncated` and `metrics` are those of the step that ended it.

    Attributes:
        final_obs: observations at the end of the step, before any reset, for a value function to bootstrap from.
        episode_return: (n_worlds, n_agents) reward summed over the running episode, or over the one that just ended.
        episode_length: (n_worlds,) int32 steps of the same episode.
        counts: (n_worlds,) int32 totals since `Worlds.reset`: "episodes" that ended, steps with a "physics_fault" or
            "contact_overflow", and episodes begun in a "layout_invalid" world.
        seed: (n_worlds,) keys that determine all episodes of a world.
        upcoming: the beginnings of the next episodes.
        recent: what happened last, of worlds with `keep_faults`; else ().
    """

    final_obs: dict[str, jax.Array]
    episode_return: jax.Array
    episode_length: jax.Array
    counts: dict[str, jax.Array]
    seed: jax.Array
    upcoming: Upcoming
    recent: Any = ()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {', '.join(summary(self))}>"

    def totals(self) -> dict[str, int]:
        """Sums `counts` over all worlds, on the host."""
        return {name: int(value.sum()) for name, value in self.counts.items()}


Watch = Callable[[WorldsState, Any, jax.Array], Any]
"""`(before, action, fault) -> recent`: what sees every step, and returns the next `WorldsState.recent`."""


def begin(
    env: Environment, n_worlds: int, index: jax.Array, key: jax.Array, params: DomainParams, stagger: jax.Array
) -> WorldsState:
    """Draws the first episodes of some worlds.

    Args:
        env: the environment.
        n_worlds: number of all worlds, over which `stagger` spreads the ends.
        index: (n,) int32, indices of these worlds; `key` and the index alone determine a world.
        key: key of all worlds.
        params: ranges with leaves (n, 2).
        stagger: () bool, whether ends are spread over the horizon.
    """
    n = len(index)
    seed = jax.vmap(lambda i: jax.random.fold_in(key, i))(index)
    # One reset for the episodes 0 and 1 of all worlds: two resets would compile twice.
    keys = jnp.concatenate([_episode_key(seed, jnp.full(n, e)) for e in (0, 1)])
    both = strong(jax.vmap(env.reset)(keys, jax.tree.map(lambda x: jnp.concatenate([x, x]), params)))
    first, second = jax.tree.map(lambda x: x[:n], both), jax.tree.map(lambda x: x[n:], both)
    age = (index * (env.base.horizon or 0) // n_worlds).astype(jnp.int32)
    first = first.replace(step=jnp.where(stagger, age, first.step))
    zeros = jnp.zeros(n, jnp.int32)
    return WorldsState(
        **_fields(first),
        final_obs=first.obs,
        episode_return=jnp.zeros_like(first.reward),
        episode_length=zeros,
        counts={
            "episodes": zeros,
            "physics_fault": zeros,
            "layout_invalid": (~first.world.valid).astype(jnp.int32),
            "contact_overflow": zeros,
        },
        seed=seed,
        upcoming=Upcoming(state=beginning(second), stale=jnp.zeros(n, bool)),
    )


def advance(
    env: Environment, states: WorldsState, action: Any, watch: Watch | None = None, visited: Visited | None = None
) -> WorldsState:
    """Steps all worlds once, and begins the next episode where one ended.

    Args:
        env: the environment.
        states: the worlds' states.
        action: with a leading axis (n_worlds,).
        watch: sees the step.
        visited: with what episodes begin instead; what was drawn for them is kept for the next one.
    """
    stepped = strong(jax.vmap(env.step)(plain(states), action))
    done = stepped.done
    # The first step after an episode's end restarts the sums.
    running = ~states.done

    @jax.named_scope("reset")
    def begin_next(stepped: State, upcoming: Upcoming) -> tuple[State, Upcoming]:
        used = done if visited is None else done & ~visited.taken
        # Drawn for those that begin with a visited state, too: a world's draws never depend on its neighbours.
        upcoming = _draw_next(env, upcoming, states, urgent=done & upcoming.stale)
        fresh = upcoming.state if visited is None else _with_visited(upcoming.state, stepped, visited)
        return _merge(env, stepped, fresh, done), upcoming.replace(stale=upcoming.stale | used)

    current, upcoming = jax.lax.cond(done.any(), begin_next, lambda *same: same, stepped, states.upcoming)
    counts = {
        "episodes": states.counts["episodes"] + done,
        "physics_fault": states.counts["physics_fault"] + stepped.metrics["physics_fault"],
        "layout_invalid": states.counts["layout_invalid"] + (done & ~current.world.valid),
        "contact_overflow": states.counts["contact_overflow"] + stepped.metrics["contact_overflow"],
    }
    return states.replace(
        **_fields(current),
        final_obs=stepped.obs,
        episode_return=jnp.where(running[:, None], states.episode_return, 0.0) + stepped.reward,
        episode_length=jnp.where(running, states.episode_length, 0) + 1,
        counts=counts,
        upcoming=upcoming,
        recent=states.recent if watch is None else watch(states, action, stepped.metrics["physics_fault"]),
    )


def stale_under(params: DomainParams, old: DomainParams, stale: jax.Array) -> jax.Array:
    """Returns which beginnings are stale after a change of ranges: already stale ones, and those of other ranges."""
    before, now = (jnp.stack(jax.tree.leaves(p), axis=1) for p in (old, params))
    return stale | (before != now).any(axis=(1, 2))


def _draw_next(env: Environment, upcoming: Upcoming, states: WorldsState, urgent: jax.Array) -> Upcoming:
    """Draws used-up beginnings: all `urgent` ones, and others once they fill a chunk."""
    n = len(urgent)
    chunk = min(n, max(LEAST_CHUNK, n // CHUNKS))

    def wanting(upcoming: Upcoming) -> jax.Array:
        return (urgent & upcoming.stale).any() | (upcoming.stale.sum() >= chunk)

    def draw_chunk(upcoming: Upcoming) -> Upcoming:
        rank = jnp.where(urgent & upcoming.stale, 2, jnp.where(upcoming.stale, 1, 0))
        picked_rank, picked = jax.lax.top_k(rank, chunk)
        keys = _episode_key(states.seed[picked], states.counts["episodes"][picked] + 1)
        params = jax.tree.map(lambda x: x[picked], states.params)
        drawn = beginning(jax.vmap(env.reset)(keys, params))
        # Worlds that only fill up the chunk are not stale and keep their beginnings.
        target = jnp.where(picked_rank > 0, picked, n)
        source = jnp.full(n, -1).at[target].set(jnp.arange(chunk), mode="drop")
        # Gathered: a scatter is a loop to compile on a CPU, once for every array of a state.
        state = jax.tree.map(lambda old, new: _where(source >= 0, new[source], old), upcoming.state, drawn)
        return Upcoming(state=state, stale=upcoming.stale & (source < 0))

    return jax.lax.while_loop(wanting, draw_chunk, upcoming)


def _with_visited(drawn: State, stepped: State, visited: Visited) -> State:
    """Returns beginnings, visited ones where they are taken, which go on with the world's own key."""
    given = beginning(plain(visited.state))
    rows = jax.tree.map(lambda x: x[visited.index], given).replace(key=stepped.key)
    return jax.tree.map(partial(_where, visited.taken), rows, drawn)


def _merge(env: Environment, stepped: State, fresh: State, done: jax.Array) -> State:
    """Returns `stepped`, with the next episode's beginning where one is done; the step's results stay."""
    merged = jax.tree.map(partial(_where, done), fresh, beginning(stepped))
    engine = jax.vmap(env.base.engine.renew)(stepped.data.engine, done)
    results = {name: getattr(stepped, name) for name in RESULTS}
    return merged.replace(data=merged.data.replace(engine=engine), **results)


def _where(worlds: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    """Returns `new` in the given `worlds` (n,) bool, `old` in the others."""
    return jnp.where(worlds.reshape(-1, *[1] * (old.ndim - 1)), new, old)


def _fields(state: State) -> dict[str, Any]:
    return {name: getattr(state, name) for name in FIELDS}


def _episode_key(seed: jax.Array, episode: jax.Array) -> jax.Array:
    return jax.vmap(jax.random.fold_in)(seed, episode)


def without_engine(state: State) -> State:
    """Removes what an engine carries: it belongs to the running batch and is never part of a stored world."""
    return state.replace(data=state.data.replace(engine=()))


def beginning(state: State) -> State:
    """Returns what an episode begins with: a stored world without a step's results, which every step would copy."""
    return without_engine(state).replace(**dict.fromkeys(RESULTS, ()))
