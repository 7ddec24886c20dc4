"""Who plays with whom."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.wrapper import ObservationWrapper

HIDERS, SEEKERS = 0, 1


class TeamMembership(ObservationWrapper):
    """Gives every agent a team (thesis 5.2.1). Team 0 hides and team 1 seeks, where a game has these.

    Adds `agent_team` (n_agents, 1): its number; and `team_size` (n_agents, 1): how many of this world's agents are in
    it. Both are 0 for absent agents.

    Args:
        env: what to wrap.
        team_index: the team of every agent slot; None takes the teams that `Agents` was given.

    Attributes:
        team_index: (n_agents,) int.
        n_teams: how many teams there are.

    Raises:
        ValueError: not one whole number of at least 0 per agent.
    """

    name = "team_membership"

    def __init__(self, env: Environment, team_index: Sequence[int] | None = None):
        super().__init__(env)
        index = np.asarray(env.base.agents.team_index if team_index is None else team_index)
        if index.shape != (env.base.n_agents,) or index.dtype.kind not in "iu" or (index < 0).any():
            raise ValueError(
                f"team_index: got {team_index!r}; takes {env.base.n_agents} whole numbers of at least 0, one per agent"
            )
        self.team_index = index
        self.n_teams = int(index.max()) + 1

    def of(self, team: int) -> np.ndarray:
        """(n_agents,) bool: whose slots are in a team."""
        return self.team_index == team

    def observation(self, state: State) -> dict[str, jax.Array]:
        active = self.playing(state)
        same = self.team_index[:, None] == self.team_index
        size = (same & active).sum(axis=1) * active
        obs = {"agent_team": self.team_index * active, "team_size": size}
        return state.obs | {name: x[:, None].astype(jnp.float32) for name, x in obs.items()}
