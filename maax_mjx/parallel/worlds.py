"""`Worlds`: a batch of worlds with automatic resets, every episode in a layout of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.checks import check_count, check_key, check_not_donated
from maax_mjx.env import Environment
from maax_mjx.params import DomainParams, check_params
from maax_mjx.spaces import check_action
from maax_mjx.state import State


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


class Worlds:
    """`n_worlds` worlds of one environment, stepped together and reset one by one.

    What becomes of a world depends on its own key alone: not on its neighbours, nor on their number. Next episodes
    are drawn ahead of time in chunks, so that a step pays for about `n_worlds / horizon` resets, and none waits for
    the others.

    Args:
        env: the environment.
        n_worlds: how many.
        donate: whether `step` reuses the memory of the states that it is given, which must not be used again.

    Raises:
        ValueError: an argument out of its range.
    """

    def __init__(self, env: Environment, n_worlds: int, *, donate: bool = True):
        if not isinstance(env, Environment):
            raise ValueError(f"env: got {env!r}; takes an environment, as maax.make(...) gives it")
        self.env = env
        self.n_worlds = check_count("n_worlds", n_worlds, minimum=1)
        self.chunk = min(self.n_worlds, max(64, self.n_worlds // 16))
        self._reset = jax.jit(self.reset_fn)
        self._step: Callable = jax.jit(self.step_fn, donate_argnums=0 if donate else ())
        self._sample = jax.jit(lambda key: jax.vmap(env.sample_action)(jax.random.split(key, self.n_worlds)))

    def reset(self, key: jax.Array, params: DomainParams | None = None, *, stagger: bool = False) -> WorldsState:
        """Draws all worlds.

        Args:
            key: a typed key; world i follows from it and i alone.
            params: ranges with leaves (2,), or (n_worlds, 2) for a range per world; None is the defaults.
            stagger: whether the first episodes end spread over the horizon rather than all at once, which keeps
                training batches and their cost even.

        Raises:
            ValueError: a raw uint32 key, or params beyond their bounds.
        """
        check_key("key", key)
        params = self.env.default_params if params is None else params
        return self._reset(key, self._per_world(params), jnp.asarray(stagger))

    def step(self, states: WorldsState, action: Any) -> WorldsState:
        """Advances every world by one env step, and starts the next episode where one ended.

        Args:
            states: from `reset` or `step`; donated.
            action: the env's action with a leading axis (n_worlds,).

        Raises:
            ValueError: an action of a wrong shape or with NaN, or states of other worlds.
            RuntimeError: states that were donated to an earlier call.
        """
        if not isinstance(states, WorldsState) or jnp.shape(states.step) != (self.n_worlds,):
            got = f"{jnp.size(states.step)} worlds" if isinstance(states, WorldsState) else type(states).__name__
            raise ValueError(f"states: got {got}; takes the WorldsState of {self.n_worlds} worlds that reset gives")
        check_not_donated(states.step)
        check_action(self.env.action_space, action, (self.n_worlds,))
        return self._step(states, action)

    def with_params(self, states: WorldsState, params: DomainParams) -> WorldsState:
        """The states with other ranges, which hold from every world's next episode on; nothing is compiled anew.

        Args:
            states: from `reset` or `step`.
            params: ranges with leaves (2,), or (n_worlds, 2) for a range per world.

        Raises:
            ValueError: params beyond their bounds.
        """
        params = self._per_world(params)
        old, new = (jnp.stack(jax.tree.leaves(p), axis=1) for p in (states.params, params))
        # Beginnings drawn from the old ranges are drawn again, where the ranges are others.
        stale = states.upcoming.stale | (old != new).any(axis=(1, 2))
        return states.replace(params=params, upcoming=states.upcoming.replace(stale=stale))

    def _per_world(self, params: DomainParams) -> DomainParams:
        """A range for every world, in memory of their own, since states are donated."""
        check_params(params, self.env.base.parameters, (self.n_worlds,))
        return jax.tree.map(lambda x: jnp.array(jnp.broadcast_to(x, (self.n_worlds, 2))), params)

    def sample_action(self, key: jax.Array) -> dict[str, jax.Array]:
        """A uniform random action for every world."""
        return self._sample(key)

    def reset_fn(self, key: jax.Array, params: DomainParams, stagger: jax.Array) -> WorldsState:
        """`reset` as a pure function, for use inside other traced code; params have leaves (n_worlds, 2)."""
        n = self.n_worlds
        seed = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(n))
        # One reset of the episodes 0 and 1 of all worlds: two would compile twice.
        keys = jnp.concatenate([_episode_key(seed, jnp.full(n, e)) for e in (0, 1)])
        both = jax.vmap(self.env.reset)(keys, jax.tree.map(lambda x: jnp.concatenate([x, x]), params))
        first, second = jax.tree.map(lambda x: x[:n], both), jax.tree.map(lambda x: x[n:], both)
        age = (jnp.arange(n) * self.env.base.horizon // n).astype(jnp.int32)
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

    def step_fn(self, states: WorldsState, action: Any) -> WorldsState:
        """`step` as a pure function, for use inside other traced code, such as a scanned rollout."""
        stepped = jax.vmap(self.env.step)(State(**{k: getattr(states, k) for k in _STATE_FIELDS}), action)
        done = stepped.done
        # The first step after an episode's end starts the sums anew.
        running = ~states.done

        @jax.named_scope("reset")
        def begin(stepped: State, upcoming: Upcoming) -> tuple[State, Upcoming]:
            upcoming = self._draw_next(upcoming, states, urgent=done & upcoming.stale)
            return self._begin_next(stepped, upcoming.state, done), upcoming.replace(stale=upcoming.stale | done)

        current, upcoming = jax.lax.cond(done.any(), begin, lambda *same: same, stepped, states.upcoming)
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

    def _draw_next(self, upcoming: Upcoming, states: WorldsState, urgent: jax.Array) -> Upcoming:
        """Draws used-up beginnings: all `urgent` ones, and others once they fill a chunk."""

        def wanting(upcoming: Upcoming) -> jax.Array:
            return (urgent & upcoming.stale).any() | (upcoming.stale.sum() >= self.chunk)

        def draw_chunk(upcoming: Upcoming) -> Upcoming:
            rank = jnp.where(urgent & upcoming.stale, 2, jnp.where(upcoming.stale, 1, 0))
            picked_rank, picked = jax.lax.top_k(rank, self.chunk)
            keys = _episode_key(states.seed[picked], states.counts["episodes"][picked] + 1)
            params = jax.tree.map(lambda x: x[picked], states.params)
            drawn = _without_engine(jax.vmap(self.env.reset)(keys, params))
            # What fills up the chunk is not stale and stays as it was drawn.
            target = jnp.where(picked_rank > 0, picked, self.n_worlds)
            state = jax.tree.map(lambda old, new: old.at[target].set(new, mode="drop"), upcoming.state, drawn)
            return Upcoming(state=state, stale=upcoming.stale.at[target].set(False, mode="drop"))

        return jax.lax.while_loop(wanting, draw_chunk, upcoming)

    def _begin_next(self, stepped: State, fresh: State, done: jax.Array) -> State:
        """`stepped`, with the next episode's beginning where one is done; what happened in the step stays."""

        def pick(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(done.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        merged = jax.tree.map(pick, fresh, _without_engine(stepped))
        engine = jax.vmap(self.env.base.engine.renew)(stepped.data.engine, done)
        return merged.replace(
            data=merged.data.replace(engine=engine),
            reward=stepped.reward,
            terminated=stepped.terminated,
            truncated=stepped.truncated,
            metrics=stepped.metrics,
            params=stepped.params,
        )


_STATE_FIELDS = tuple(State.__dataclass_fields__)


def _fields(state: State) -> dict[str, Any]:
    return {name: getattr(state, name) for name in _STATE_FIELDS}


def _episode_key(seed: jax.Array, episode: jax.Array) -> jax.Array:
    return jax.vmap(jax.random.fold_in)(seed, episode)


def _without_engine(state: State) -> State:
    """What an engine carries belongs to the running batch and is never part of a stored world."""
    return state.replace(data=state.data.replace(engine=()))
