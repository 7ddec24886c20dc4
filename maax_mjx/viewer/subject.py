"""The subject of pictures: an environment's model, its agents and their teams."""

from __future__ import annotations

import mujoco
import numpy as np

from maax_mjx.common.colours import Colour
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import State
from maax_mjx.modules.placed import Placed
from maax_mjx.viewer.materials import Materials


class Subject:
    """All that is the same in every picture of an environment.

    Args:
        env: the environment.

    Attributes:
        env: the environment.
        base: what is under its wrappers.
        model: the compiled model.
        agents: the module of the agents.
        teams: by name.
        team: (n_agents,) the number of every slot's team.
        numbers: (n_agents,) of every slot, its number within its team.
        colours: of the agents, by slot.
        kinds: of what worlds have, such as "agent", "box" and "flag".
        meshes: by their numbers in the model, (n, 3) vertices in metres and (m, 3) faces.
        materials: what geoms and sites are painted with.

    Raises:
        ValueError: not an environment.
    """

    def __init__(self, env: Environment):
        self.env, self.base = check_environment(env), env.base
        self.model, self.agents = self.base.model, self.base.agents
        self.teams = env.teams
        self.team, self.numbers = np.zeros(self.agents.n_max, int), np.zeros(self.agents.n_max, int)
        for i, team in enumerate(self.teams.values()):
            self.team[list(team.slots)] = i
            self.numbers[list(team.slots)] = np.arange(team.n_agents)
        self.colours = self._agent_colours()
        self.kinds = {module.kind for module in self.base.modules.values() if isinstance(module, Placed)}
        self.materials = Materials(self.model)
        self.meshes = {int(m): _mesh(self.model, int(m)) for m in np.unique(self.model.geom_dataid) if m >= 0}

    def playing(self, state: State) -> np.ndarray:
        """(n,) the slots of the agents in play."""
        return np.flatnonzero(np.asarray(state.world.active[self.agents.kind]))

    def _agent_colours(self) -> list[Colour]:
        """Their own where they have different ones, else those of the teams."""
        own: list[Colour] = [tuple(row) for row in self.agents.colours.tolist()]
        teams = list(self.teams.values())
        return own if len(set(own)) > 1 else [teams[team].colour for team in self.team]


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) vertices in metres and (m, 3) faces."""
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    return np.array(model.mesh_vert[vertices]), np.array(model.mesh_face[faces])
