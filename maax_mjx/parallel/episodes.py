"""Episodes of a batch of worlds: begun, stepped, ended, begun anew. Pure functions of however many there are."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import FIELDS, State, plain

LEAST_CHUNK, CHUNKS = 64, 16
"""Next episodes are drawn in chunks of a sixteenth of the worlds, but not of fewer than 64."""


class Upcoming(struct.PyTreeNode):
    """The beginnings of the next episodes, drawn ahead of time.

    Attributes:
        state: what every world's next episode starts from.
        stale: (n_worlds,) bool, where it is used up and has to be drawn.
    """

    state: State
    stale: jax.Array


class WorldsState(State):
    """The states of a batch; every field of `State` has a leading axis (n_worlds,).

    Where a step ended an episode, `obs`, `data`, `world`, `step`, `key` and `mechanics` are the next
    episode's first, while `reward`, `terminated`, `truncated` and `metrics` are those of the step that ended it.

    Attributes:
        final_obs: the observations at the end of the step, before any reset: what a value function bootstraps from.
        episode_return: (n_worlds, n_agents) reward summed over the running episode, or over the one that just ended.
        episode_length: (n_worlds,) int32 steps, likewise.
        counts: int32 totals since `Worlds.reset`, (n_worlds,) each: "episodes" ended, steps with a "physics_fault" or
            "contact_overflow", and episodes begun in a "layout_invalid" world.
        seed: (n_worlds,) keys from which all episodes of a world follow.
        upcoming: the beginnings of the next episodes.
    """

    final_obs: dict[str, jax.Array]
    episode_return: jax.Array
    episode_length: jax.Array
    counts: dict[str, jax.Array]
    seed: jax.Array
    upcoming: Upcoming

    def totals(self) -> dict[str, int]:
        """`counts`, summed over all worlds. Host."""
        return {name: int(value.sum()) for name, value in self.counts.items()}


def begin(
    env: Environment, n_worlds: int, index: jax.Array, key: jax.Array, params: DomainParams, stagger: jax.Array
) -> WorldsState:
    """The first episodes of some worlds.

    Args:
        env: the environment.
        n_worlds: how many worlds there are in all, over which `stagger` spreads their ends.
        index: (n,) int32, which of them these are; a world follows from `key` and its index alone.
        key: the key of all worlds.
        params: ranges with leaves (n, 2).
        stagger: () bool.
    """
    n = len(index)
    seed = jax.vmap(lambda i: jax.random.fold_in(key, i))(index)
    # One reset of the episodes 0 and 1 of all worlds: two would compile twice.
    keys = jnp.concatenate([_episode_key(seed, jnp.full(n, e)) for e in (0, 1)])
    both = jax.vmap(env.reset)(keys, jax.tree.map(lambda x: jnp.concatenate([x, x]), params))
    first, second = jax.tree.map(lambda x: x[:n], both), jax.tree.map(lambda x: x[n:], both)
    age = (index * env.base.horizon // n_worlds).astype(jnp.int32)
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
        upcoming=Upcoming(state=_without_engine(second), stale=jnp.zeros(n, bool)),
    )


def advance(env: Environment, states: WorldsState, action: Any) -> WorldsState:
    """All worlds an env step further, the next episode begun where one ended."""
    stepped = jax.vmap(env.step)(plain(states), action)
    done = stepped.done
    # The first step after an episode's end starts the sums anew.
    running = ~states.done

    @jax.named_scope("reset")
    def begin_next(stepped: State, upcoming: Upcoming) -> tuple[State, Upcoming]:
        upcoming = _draw_next(env, upcoming, states, urgent=done & upcoming.stale)
        return _merge(env, stepped, upcoming.state, done), upcoming.replace(stale=upcoming.stale | done)

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
    )


def stale_under(params: DomainParams, old: DomainParams, stale: jax.Array) -> jax.Array:
    """Which beginnings are stale under new ranges: those drawn from others, and those that were already."""
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
        drawn = _without_engine(jax.vmap(env.reset)(keys, params))
        # What fills up the chunk is not stale and stays as it was drawn.
        target = jnp.where(picked_rank > 0, picked, n)
        source = jnp.full(n, -1).at[target].set(jnp.arange(chunk), mode="drop")
        # Gathered, since on a CPU every scatter is a loop to compile, and there are as many as a state has arrays.
        state = jax.tree.map(lambda old, new: _where(source >= 0, new[source], old), upcoming.state, drawn)
        return Upcoming(state=state, stale=upcoming.stale & (source < 0))

    return jax.lax.while_loop(wanting, draw_chunk, upcoming)


def _merge(env: Environment, stepped: State, fresh: State, done: jax.Array) -> State:
    """`stepped`, with the next episode's beginning where one is done; what happened in the step stays."""
    merged = jax.tree.map(partial(_where, done), fresh, _without_engine(stepped))
    engine = jax.vmap(env.base.engine.renew)(stepped.data.engine, done)
    return merged.replace(
        data=merged.data.replace(engine=engine),
        reward=stepped.reward,
        terminated=stepped.terminated,
        truncated=stepped.truncated,
        metrics=stepped.metrics,
        params=stepped.params,
    )


def _where(worlds: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    """`new` in those `worlds` (n,) bool, `old` in the others."""
    return jnp.where(worlds.reshape(-1, *[1] * (old.ndim - 1)), new, old)


def _fields(state: State) -> dict[str, Any]:
    return {name: getattr(state, name) for name in FIELDS}


def _episode_key(seed: jax.Array, episode: jax.Array) -> jax.Array:
    return jax.vmap(jax.random.fold_in)(seed, episode)


def _without_engine(state: State) -> State:
    """What an engine carries belongs to the running batch and is never part of a stored world."""
    return state.replace(data=state.data.replace(engine=()))
