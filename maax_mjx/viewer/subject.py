"""What the pictures of one environment are of: its model, its agents and their teams."""

from __future__ import annotations

import mujoco
import numpy as np

from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import State
from maax_mjx.core.teams import Colour, Team, make_teams
from maax_mjx.modules.placed import Placed
from maax_mjx.viewer import palette
from maax_mjx.wrappers import TeamMembership, find


class Subject:
    """What is the same in all pictures of an environment.

    Args:
        env: the environment.

    Attributes:
        env: the environment.
        base: what is under its wrappers.
        model: the compiled model.
        agents: the module of the agents.
        teams: by name.
        team: (n_agents,) of every slot, the number of its team.
        numbers: of every slot, its number within its team.
        colours: of every slot.
        kinds: of what worlds have, such as "agent", "box" and "flag".
        meshes: by their numbers in the model, (n, 3) vertices in metres and (m, 3) faces.

    Raises:
        ValueError: not an environment.
    """

    def __init__(self, env: Environment):
        self.env, self.base = check_environment(env), env.base
        self.model, self.agents = self.base.model, self.base.agents
        self.teams = teams_of(env)
        self.team, self.numbers = np.zeros(self.agents.n_max, int), np.zeros(self.agents.n_max, int)
        for i, team in enumerate(self.teams.values()):
            self.team[list(team.slots)] = i
            self.numbers[list(team.slots)] = np.arange(team.n_agents)
        self.colours = self._agent_colours()
        self.kinds = {module.kind for module in self.base.modules.values() if isinstance(module, Placed)}
        self.meshes = {int(m): _mesh(self.model, int(m)) for m in np.unique(self.model.geom_dataid) if m >= 0}

    def playing(self, state: State) -> np.ndarray:
        """(n,) the slots of the agents in play."""
        return np.flatnonzero(np.asarray(state.world.active[self.agents.kind]))

    def team_colour(self, team: int) -> Colour:
        """The colour of a team's first agent."""
        return self.colours[int(np.flatnonzero(self.team == team)[0])]

    def _agent_colours(self) -> list[Colour]:
        own = self.agents.colors
        if len(self.teams) > 1 and (own == own[0]).all():
            own = np.array([palette.TEAMS[team % len(palette.TEAMS)] for team in self.team])
        return [tuple(row) for row in own.tolist()]


def teams_of(env: Environment) -> dict[str, Team]:
    """The environment's teams by name."""
    teams: dict[str, Team] | None = getattr(env, "teams", None)
    if teams is not None:
        return teams
    agents, membership = env.base.agents, find(env, TeamMembership)
    colours: list[Colour] = [tuple(row) for row in agents.colors.tolist()]
    index = np.asarray(agents.team_index if membership is None else membership.team_index)
    numbers, index = np.unique(index, return_inverse=True)
    names = [name.removeprefix("n_") for name in agents.teams]
    if len(names) != len(numbers) or not np.array_equal(index, agents.team_index):
        names = [f"team{number}" for number in numbers]
    return make_teams(names if len(names) > 1 else ["agents"], index, colours)


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) vertices in metres and (m, 3) faces."""
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    return np.array(model.mesh_vert[vertices]), np.array(model.mesh_face[faces])
