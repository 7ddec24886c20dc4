"""A team as one agent with vectors of numbers, as libraries of continuous control want it."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from maax_mjx.adapters.agents import PerAgent
from maax_mjx.common.checks import check_choice, described, is_real_array, is_traced
from maax_mjx.common.keys import new_key
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.training import player_of
from maax_mjx.training.evaluate import seated
from maax_mjx.wrappers.actions import to_bins


class Inside(NamedTuple):
    """All that a world needs to go on.

    Attributes:
        state: of the world.
        memory: of who plays the other team.
        key: of that player's draws.
    """

    state: State
    memory: Any
    key: jax.Array


class OneTeam:
    """A game in which all agents of a team are one agent, while a policy plays the others.

    It observes the vectors of its agents, one after the other, and decides a number in [-1, 1] for everything that one
    of them decides: forces as they are, bins by the nearest, choices of two by the sign.

    Args:
        env: an environment whose agents observe for themselves.
        team: name of the team; None is all agents.
        policy: who plays the others; see `gymnasium_vector`.

    Attributes:
        env: the environment.
        observation_size, action_size: lengths of the vectors.

    Raises:
        ValueError: an unknown team, a policy without a team or the other way round, or one that does not fit.
    """

    def __init__(self, env: Environment, team: str | None = None, policy: Any = None):
        self._of = PerAgent(env)
        self.env = self._of.env
        if (team is None) != (policy is None):
            raise ValueError(f"policy: got {policy!r} with the team {team!r}; takes both, or neither for all agents")
        slots = range(env.n_agents) if team is None else env.teams[check_choice("team", team, env.teams)].slots
        self._slots = np.asarray(slots)
        self._other = None if policy is None else seated(player_of("policy", policy), self.env)
        self._widths = {name: int(np.prod(part.shape or (1,))) for name, part in self._of.parts.items()}
        (seen,) = self._of.observation_space.shape or (1,)
        self.observation_size = len(self._slots) * seen
        self.action_size = len(self._slots) * sum(self._widths.values())

    def begin(self, key: jax.Array) -> Inside:
        """Draws a world. Pure.

        Args:
            key: of the old kind or the new.
        """
        world_key, play_key = jax.random.split(new_key(key))
        memory = () if self._other is None else jax.tree.map(lambda x: x[0], self._other.memory(1))
        return Inside(self.env.reset(world_key), memory, play_key)

    def step(self, inside: Inside, vector: jax.Array) -> Inside:
        """Steps a world. Pure.

        Args:
            inside: the world.
            vector: (action_size,); what is beyond [-1, 1] counts as its end. NaN is refused; in compiled code,
                where it cannot be, a force of NaN is a physics fault, and a choice the middle bin, no lock, no grab.
        """
        mine = self.action(vector)
        key, play_key = jax.random.split(inside.key)
        if self._other is None:
            return Inside(self.env.step(inside.state, mine), inside.memory, key)
        theirs, memory = self._other.play(inside.state, play_key, inside.memory, self._other.params)
        joined = {name: jnp.asarray(x).at[self._slots].set(mine[name].astype(x.dtype)) for name, x in theirs.items()}
        return Inside(self.env.step(inside.state, joined), memory, key)

    def action(self, vector: jax.Array) -> dict[str, jax.Array]:
        """Returns what the team's agents decide by a vector, (n_team, ...) by name.

        Raises:
            ValueError: a vector of another length, or outside compiled code one with NaN.
        """
        vector = jnp.asarray(vector) if isinstance(vector, list | tuple) else vector
        if not is_real_array(vector):
            raise ValueError(f"action: got {described(vector)}; takes an array {(self.action_size,)}")
        if not is_traced(vector) and np.isnan(vector).any():
            raise ValueError("action: got NaN; takes numbers in [-1, 1]")
        if jnp.shape(vector) != (self.action_size,):
            raise ValueError(f"action: got shape {jnp.shape(vector)}; takes {(self.action_size,)}, in one world")
        rows, at, found = jnp.clip(vector, -1, 1).reshape(len(self._slots), -1), 0, {}
        for name, part in self._of.parts.items():
            numbers = rows[:, at : at + self._widths[name]].reshape(len(self._slots), *(part.shape or ()))
            at += self._widths[name]
            if isinstance(part, spaces.Box):
                found[name] = jnp.asarray(part.low + part.high) / 2 + numbers * jnp.asarray(part.high - part.low) / 2
            elif isinstance(part, spaces.MultiDiscrete):
                found[name] = to_bins(jnp.nan_to_num(numbers), int(part.nvec.flat[0]))
            else:
                found[name] = (numbers > 0).astype(jnp.int8)
        return found

    def observation(self, inside: Inside) -> jax.Array:
        """Returns (observation_size,) float32."""
        return self._of.observations(inside.state.obs)[self._slots].reshape(-1).astype(jnp.float32)

    def reward(self, inside: Inside) -> jax.Array:
        """Returns the mean of the team's agents that are in play, float32."""
        active = inside.state.world.active[self.env.base.agents.kind][self._slots]
        rewards = jnp.where(active, inside.state.reward[self._slots], 0.0)
        return (rewards.sum() / jnp.maximum(active.sum(), 1)).astype(jnp.float32)

    def done(self, inside: Inside) -> jax.Array:
        """Returns 1.0 where an episode has ended before its horizon, which those libraries see to themselves."""
        state, horizon = inside.state, self.env.base.horizon
        cut = state.truncated if horizon is None else state.truncated & (state.step < horizon)
        return (state.terminated | cut).astype(jnp.float32)

    def metrics(self, inside: Inside) -> dict[str, jax.Array]:
        """Returns the game's numbers, float32."""
        return {name: jnp.asarray(x, jnp.float32).mean() for name, x in inside.state.metrics.items()}

    def as_env(self, kind: Any, state_kind: Any, holds: str) -> Any:
        """Returns a class of environments of a library in which it is the only agent.

        Args:
            kind: the library's base class of environments.
            state_kind: the library's class of states, with `obs`, `reward`, `done`, `metrics` and `info`.
            holds: name of the state's field that holds the world.
        """
        of = self

        class Game(kind):
            """One team of a game of maax_mjx."""

            env = of.env

            def reset(self, rng: jax.Array) -> Any:
                inside = of.begin(rng)
                shown = {"obs": of.observation(inside), "reward": jnp.zeros(()), "done": jnp.zeros(())}
                return state_kind(**{holds: inside}, **shown, metrics=of.metrics(inside), info={})

            def step(self, state: Any, action: jax.Array) -> Any:
                inside = of.step(getattr(state, holds), action)
                shown = {"obs": of.observation(inside), "reward": of.reward(inside), "done": of.done(inside)}
                return state.replace(**{holds: inside}, **shown, metrics=state.metrics | of.metrics(inside))

            @property
            def observation_size(self) -> int:
                return of.observation_size

            @property
            def action_size(self) -> int:
                return of.action_size

        return Game
