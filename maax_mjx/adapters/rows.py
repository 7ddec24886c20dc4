"""A batch in which every agent of a team, in every world, is a row, while a policy plays the others."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.adapters.agents import PerAgent
from maax_mjx.common.checks import check_choice, check_count
from maax_mjx.parallel import Worlds
from maax_mjx.parallel.policy import forgotten
from maax_mjx.training import player_of
from maax_mjx.training.evaluate import seated


class Step(NamedTuple):
    """What a step of all rows led to, with the leading axis (n_rows,).

    Attributes:
        obs: what is observed now: in a new episode where one has ended.
        reward: float32.
        terminated, truncated: bool, whether the episode has ended.
        final_obs: what was observed last, before a new episode began; elsewhere `obs`.
        episode_return: float32, of the episode so far, or of the one that has ended.
        episode_length: int32, likewise.
        active: bool, whether the agent is in play now: in the new episode where one has ended.
        played: bool, whether it was in play in the step.
    """

    obs: Any
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    final_obs: Any
    episode_return: jax.Array
    episode_length: jax.Array
    active: jax.Array
    played: jax.Array


class Rows:
    """The agents of one team, or of all, as rows; world after world, in a world by slot.

    Agents that are not in play in an episode are rows as well: they observe zeros. The package's games pay them
    nothing; a reward of one's own may.

    Args:
        worlds: the batch; on one device or by shard_map.
        team: name of the team; None is all agents.
        policy: who plays the others: a `training.Policy`, a file, the folder of a run, the name of one that comes with
            the package, or a scripted one such as "random" and "chase".
        flat: see `PerAgent`.
        seed: of the worlds and of the others' actions.

    Attributes:
        of: the spaces of a row.
        n_rows: number of rows.

    Raises:
        ValueError: an unknown team, a policy without a team or the other way round, one that does not fit, or worlds of
            pmap.
    """

    def __init__(
        self, worlds: Worlds, team: str | None = None, policy: Any = None, flat: bool = True, seed: int = 0
    ) -> None:
        if not isinstance(worlds, Worlds):
            raise ValueError(f"worlds: got {worlds!r}; takes maax.Worlds")
        if worlds.shards.method == "pmap":
            raise ValueError("worlds: got those of pmap, with two leading axes; takes one device, or shard_map")
        if jax.process_count() > 1:
            raise ValueError(f"worlds: got those of {jax.process_count()} processes; takes those of one")
        if team is not None:
            check_choice("team", team, worlds.env.teams)
        if (team is None) != (policy is None):
            raise ValueError(f"policy: got {policy!r} with the team {team!r}; takes both, or neither for all agents")
        self.of = PerAgent(worlds.env, flat, "worlds")
        env = self.of.env
        if env is not worlds.env:
            worlds = worlds.with_env(env)
        self.worlds = worlds
        slots = range(env.n_agents) if team is None else env.teams[team].slots
        self._slots = np.asarray(slots)
        self.n_rows = worlds.n_worlds * len(self._slots)
        # A trained policy reads the game's arrays, beside which the rows' vectors stand.
        self._other = None if policy is None else seated(player_of("policy", policy), env)
        self._key = jax.random.key(check_count("seed", seed))
        self._states: Any = None
        self._memory: Any = ()
        self._decide = jax.jit(self._all_actions)
        self._shown = jax.jit(self._rows)

    def reset(self, seed: int | None = None, stagger: bool = False) -> Step:
        """Draws all worlds.

        Args:
            seed: None goes on from the last draw.
            stagger: see `Worlds.reset`.
        """
        if seed is not None:
            self._key = jax.random.key(check_count("seed", seed))
        self._key, key = jax.random.split(self._key)
        self._states = self.worlds.reset(key, stagger=stagger)
        if self._other is not None:
            self._memory = self._other.memory(self.worlds.n_worlds)
        return self._shown(self._states, self._states.active)

    def step(self, chosen: Any) -> Step:
        """Steps all worlds.

        Args:
            chosen: actions (n_rows, ...) as `of.action_space` has them.

        Raises:
            ValueError: before `reset`, or actions of another shape.
        """
        if self._states is None:
            raise ValueError("step: got no worlds yet; takes those that reset draws")
        self.of.check(chosen, (self.n_rows,), "actions")  # `Worlds.step` checks the numbers
        self._key, key = jax.random.split(self._key)
        params = () if self._other is None else self._other.params
        action, self._memory, played = self._decide(self._states, chosen, key, self._memory, params)
        self._states = self.worlds.step(self._states, action)
        return self._shown(self._states, played)

    def _all_actions(self, states: Any, chosen: Any, key: jax.Array, memory: Any, params: Any) -> tuple[Any, Any, Any]:
        """Returns the actions of all agents, the others' memory, and who plays, copied before states are donated."""
        played = jnp.copy(states.active)
        n, mine = self.worlds.n_worlds, len(self._slots)
        ours = self.of.action(jax.tree.map(lambda x: x.reshape(n, mine, *x.shape[1:]), chosen))
        if self._other is None:
            return ours, memory, played
        keys, memory = jax.random.split(key, n), forgotten(memory, states.done)
        theirs, memory = jax.vmap(self._other.play, (0, 0, 0, None))(states, keys, memory, params)

        def join(others: jax.Array, mine: jax.Array) -> jax.Array:
            # Wide enough for both: `Worlds.step` checks the numbers, which a cast might change.
            kind = jnp.promote_types(others.dtype, mine.dtype)
            return jnp.asarray(others, kind).at[:, self._slots].set(mine.astype(kind))

        return {name: join(x, ours[name]) for name, x in theirs.items()}, memory, played

    def _rows(self, states: Any, played: jax.Array) -> Step:
        n, mine = self.worlds.n_worlds, len(self._slots)

        def agents(x: jax.Array) -> jax.Array:
            # A copy: stepping donates the states.
            return jnp.copy(x[:, self._slots].reshape(n * mine, *x.shape[2:]))

        def every(x: jax.Array) -> jax.Array:
            return jnp.repeat(x, mine, axis=0)

        return Step(
            obs=jax.tree.map(agents, self.of.observations(states.obs)),
            reward=agents(states.reward),
            terminated=every(states.terminated),
            truncated=every(states.truncated),
            final_obs=jax.tree.map(agents, self.of.observations(states.final_obs)),
            episode_return=agents(states.episode_return),
            episode_length=every(states.episode_length),
            active=agents(states.active),
            played=agents(played),
        )
