"""Team membership as an observation."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.colours import team_colour
from maax_mjx.common.observed import AGENT, Column, Observed
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.core.teams import Team, make_teams
from maax_mjx.wrappers.wrapper import ObservationWrapper

HIDERS, SEEKERS = "hiders", "seekers"
"""Names of the two sides of hide and seek."""


class TeamMembership(ObservationWrapper):
    """Gives every agent a team (thesis 5.2.1).

    In games of hiding, "hiders" hide and "seekers" seek; where no team has either name, the first hides and the second
    seeks.

    Adds the observations `agent_team` (n_agents, 1), the team's number, and `team_size` (n_agents, 1), how many of this
    world's agents are in the team. Both are 0 for absent agents.

    Args:
        env: environment to wrap.
        team_index: team of every agent slot; None uses the teams of `Agents`.
        names: names of the teams; None uses those of `Agents` if the teams are the same, else "team_0", "team_1", ...

    Attributes:
        team_index: (n_agents,) int.
        n_teams: number of teams.

    Raises:
        ValueError: not one whole number of at least 0 per agent, a team that is empty or named twice, or another number
            of names than of teams.
    """

    name = "team_membership"

    def __init__(self, env: Environment, team_index: Sequence[int] | None = None, names: Sequence[str] | None = None):
        super().__init__(env)
        agents = env.base.agents
        index = np.asarray(agents.team_index if team_index is None else team_index)
        if index.shape != (env.base.n_agents,) or index.dtype.kind not in "iu" or (index < 0).any():
            raise ValueError(
                f"team_index: got {team_index!r}; takes {env.base.n_agents} whole numbers of at least 0, one per agent"
            )
        self.team_index = index
        self.n_teams = int(index.max()) + 1
        if names is None:
            same = np.array_equal(index, agents.team_index)
            names = list(agents.team_sizes) if same else [f"team_{i}" for i in range(self.n_teams)]
        elif isinstance(names, str) or len(names) != self.n_teams:
            raise ValueError(f"names: got {names!r}; takes {self.n_teams}, one per team")
        colours = agents.colours.tolist()
        if self.n_teams > 1 and all(colour == colours[0] for colour in colours):
            colours = [team_colour(team) for team in index]
        self._teams = make_teams(list(names), index, colours)

    @property
    def teams(self) -> dict[str, Team]:
        return self._teams

    def of(self, team: int | str) -> np.ndarray:
        """The slots of a team, by its number or name: (n_agents,) bool; none of a side that has no team here."""
        if isinstance(team, str) and team in self._teams:
            team = list(self._teams).index(team)
        elif isinstance(team, str):
            unnamed = not {HIDERS, SEEKERS} & set(self._teams)
            team = (HIDERS, SEEKERS).index(team) if unnamed and team in (HIDERS, SEEKERS) else -1
        return self.team_index == team

    def observation(self, state: State) -> dict[str, jax.Array]:
        active = self.playing(state)
        same = self.team_index[:, None] == self.team_index
        size = (same & active).sum(axis=1) * active
        obs = {"agent_team": self.team_index * active, "team_size": size}
        return state.obs | {name: x[:, None].astype(jnp.float32) for name, x in obs.items()}

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | {
            "agent_team": Observed((AGENT,), (Column("team"),), private=False),
            "team_size": Observed((AGENT,), (Column("team size"),)),
        }
