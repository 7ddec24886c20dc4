"""Observations for a value function, which may see more than any agent."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_choice
from maax_mjx.common.observed import AGENT, Observed, flag
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.senses import LineOfSight
from maax_mjx.wrappers.split import SplitObservations
from maax_mjx.wrappers.teams import TeamMembership
from maax_mjx.wrappers.wrapper import ObservationWrapper, find


class CriticObservations(ObservationWrapper):
    """Adds observations for critics to those of the policies.

    A policy's view and a critic's are two maskings of the same arrays: a policy sees what its `seen` masks show, the
    critic of all sees everything in play, and the critic of a team what any of the team sees. Adds, for critics only:

    - `time_left` (n_agents, 1): share of the episode that is left, from 1 down to 0; of an endless game always 1. What
      is observed under this name already, as with `EgocentricObservations`, stays as it is.
    - `who_sees_whom` (n_agents, n_agents, n_agents), with `LineOfSight`: per observer, which agents (rows) see which
      (columns), both in the observer's circulant order: itself, i - 1, i - 2, ... A team's critic knows only its team's
      rows.
    - `team_<mask>`, for a team's critic: for every mask of what an agent sees, such as `sees_box` (n_agents, n), the
      mask of what any agent of its team sees.

    Args:
        env: environment to wrap, with split observations.
        observe: "all" or "team": whose view the critic has.

    Raises:
        ValueError: observations that are not split; "team" without `TeamMembership` and `LineOfSight`, or where a mask
            of what agents see is not observed.
    """

    name = "critic_observations"
    requires = (SplitObservations,)

    def __init__(self, env: Environment, observe: str = "all"):
        super().__init__(env)
        self.of = check_choice("observe", observe, ("all", "team"))
        self._sight = find(env, LineOfSight)
        n = env.base.n_agents
        self._order = (np.arange(n)[:, None] - np.arange(n)) % n
        self._mates = np.ones((n, n), bool)
        if self.of == "team":
            if self._sight is None:
                raise ValueError("observe: got 'team' without LineOfSight, so that nothing is hidden; takes 'all'")
            team = self.inner(TeamMembership).team_index
            self._mates = team == team[:, None]
            for mask in self._team_masks():
                if mask not in env.observation_space.spaces:
                    raise ValueError(f"observe: got 'team' where {mask!r} is not observed; takes that mask, or 'all'")

    def observation(self, state: State) -> dict[str, jax.Array]:
        n = self.base.n_agents
        obs = {"time_left": time_left(state, self.base.horizon, n)} | state.obs
        if self._sight is None:
            return obs
        order, sees_agent = self._order, state.mechanics[LineOfSight.name]["sees_agent"]
        known = sees_agent & self._mates[:, :, None]
        obs["who_sees_whom"] = known[np.arange(n)[:, None, None], order[:, :, None], order[:, None, :]]
        for name in self._team_masks():
            sees = sees_agent if name == "sees_agent" else jnp.asarray(state.obs[name] > 0)
            ours = jnp.any(self._mates[:, :, None] & sees, axis=1)
            if name == "sees_agent":
                ours = ours[np.arange(n)[:, None], order[:, 1:]]
                ours = jnp.pad(ours, ((0, 0), (0, state.obs[name].shape[1] - (n - 1))))  # as SpoofEntities pads it
            obs[f"team_{name}"] = ours
        return obs

    def declared(self) -> dict[str, Observed]:
        table = {"time_left": Observed((AGENT,), flag("time left"), critic=True)} | self.env.declared()
        if self._sight is None:
            return table
        table["who_sees_whom"] = Observed((AGENT, AGENT, AGENT), critic=True)
        for name in self._team_masks():
            table[f"team_{name}"] = replace(self.env.observed[name], critic=True)
        return table

    def _team_masks(self) -> list[str]:
        """The masks of what agents see, of which a team's critic gets the union over its team."""
        if self.of != "team":
            return []
        return list(dict.fromkeys(one.seen for one in self.env.observed.values() if one.seen and one.columns))


def time_left(state: State, horizon: int | None, n_agents: int) -> jax.Array:
    """The share of the episode that is left, from 1 down to 0, or 1 without a horizon: (n_agents, 1)."""
    left = jnp.ones(()) if horizon is None else jnp.maximum(1 - state.step / horizon, 0.0)
    return jnp.full((n_agents, 1), left, jnp.float32)
