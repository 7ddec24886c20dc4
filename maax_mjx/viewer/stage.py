"""From a state of an environment to what is to be seen of it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.viewer import palette
from maax_mjx.viewer.marks import Marks
from maax_mjx.viewer.palette import Colour, blend
from maax_mjx.viewer.scene import UPRIGHT, Frame, Line, Part, Shape, turned
from maax_mjx.wrappers import CaptureTheFlag, PreparationPhase, TeamMembership, find
from maax_mjx.wrappers.teams import SEEKERS

CUT = 0.51
"""Metres at which higher walls are cut, so that pictures look into the rooms: a little above the others."""
DOOR_HEIGHT = 0.006
GONE = -5.0
"""Height in metres below which geoms are those of what a world does not have."""
KINDS = {
    mujoco.mjtGeom.mjGEOM_BOX: ("box", 3),
    mujoco.mjtGeom.mjGEOM_SPHERE: ("sphere", 1),
    mujoco.mjtGeom.mjGEOM_CYLINDER: ("cylinder", 2),
    mujoco.mjtGeom.mjGEOM_CAPSULE: ("capsule", 2),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: ("ellipsoid", 3),
    mujoco.mjtGeom.mjGEOM_MESH: ("mesh", 0),
}
WAITS = 0.55
"""How dark seekers are while they wait, and agents that are out: paler, they would look like boxes."""


class Stage:
    """Looks at the states of one environment.

    Args:
        env: the environment.
        vision: whether to show who sees where and whom; needs `LineOfSight`.
        lidar: whether to show the rays of `Lidar`, which it needs.

    Attributes:
        meshes: by their numbers in the model, (n, 3) vertices and (m, 3) faces.
        teams: the names of all teams.

    Raises:
        ValueError: no environment, or a sense that it does not have.
    """

    def __init__(self, env: Environment, *, vision: bool = False, lidar: bool = False):
        self.env, self.base = check_environment(env), env.base
        self.model = self.base.model
        self.agents = self.base.agents
        membership = find(env, TeamMembership)
        self.team = np.asarray(self.agents.team_index if membership is None else membership.team_index)
        self.teams = self._team_names()
        self.colours = self._agent_colours()
        self.preparation = find(env, PreparationPhase)
        self.flags = find(env, CaptureTheFlag)
        self.geom_names = {self.model.geom(i).name for i in range(self.model.ngeom)}
        self.marks = Marks(self, vision=vision, lidar=lidar)
        self.meshes = {int(m): self._mesh(int(m)) for m in np.unique(self.model.geom_dataid) if m >= 0}
        self._entities = [m for m in self.base.modules.values() if isinstance(m, Entities) and m.n_max]
        self._slot_of = {
            int(geom): (module, int(slot))
            for module in self._entities
            for geom, slot in zip(module.all_geom_ids, module.slot_of_geom, strict=True)
        }

    @property
    def dt(self) -> float:
        """Seconds of one env step."""
        return self.base.dt

    def frame(self, state: State, returns: np.ndarray | None = None) -> Frame:
        """What there is to see.

        Args:
            state: of a single world, on the host.
            returns: (n_agents,) reward summed over the running episode, where it is known.
        """
        plan = state.world.plan
        sizes = self._sizes(state)
        solids = [part for geom in range(self.model.ngeom) for part in self._solid(state, geom, sizes[geom])]
        marks = self.marks(state)
        parts = [*self._doors(plan), *solids, *self._sites(state), *marks.parts]
        # A hand that holds something is where the mark says.
        parts = list({part.name: part for part in parts}.values())
        lines = [*self._headings(state), *marks.lines]
        text = self._text(state, returns)
        preparing = self.preparing(state)
        return Frame(float(plan.floor_size), parts, lines, marks.labels, marks.locks, text, preparing)

    def preparing(self, state: State) -> bool:
        """Whether the preparation phase runs."""
        return self.preparation is not None and int(state.step) < self.preparation.n_steps

    def position(self, state: State, body: int) -> np.ndarray:
        """(3,) metres, in float64."""
        return np.asarray(state.data.xpos[body], float)

    def heading(self, state: State, agent: int) -> float:
        """Radians from the x axis to where an agent faces."""
        return float(state.data.qpos[self.agents.qpos_ids[agent, 3]]) - np.pi / 2

    def playing(self, state: State) -> np.ndarray:
        """(n,) the slots of the agents in play."""
        return np.flatnonzero(np.asarray(state.world.active[self.agents.kind]))

    def _team_names(self) -> list[str]:
        names = list(self.agents.team_sizes)
        given = self.agents.team_index
        if len(names) > 1 and np.array_equal(self.team, given):
            return names
        return ["agents"] if self.team.max() == 0 else [f"team {i}" for i in range(self.team.max() + 1)]

    def _agent_colours(self) -> list[Colour]:
        own = self.agents.colors
        if len(np.unique(self.team)) > 1 and (own == own[0]).all():
            own = np.array([palette.TEAMS[team % len(palette.TEAMS)] for team in self.team])
        return [tuple(row) for row in own.tolist()]

    def team_colour(self, team: int) -> Colour:
        """That of its first agent."""
        slots = np.flatnonzero(self.team == team)
        return self.colours[slots[0]] if len(slots) else palette.GREY

    def _colour(self, state: State, agent: int) -> Colour:
        waits = self.preparing(state) and self.team[agent] == SEEKERS
        if self.flags is not None:
            waits |= bool(state.mechanics[self.flags.name].out[agent])
        return blend(self.colours[agent], palette.DARK, WAITS) if waits else self.colours[agent]

    def _mesh(self, mesh: int) -> tuple[np.ndarray, np.ndarray]:
        model = self.model
        vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
        faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
        return np.array(model.mesh_vert[vertices]), np.array(model.mesh_face[faces])

    def _solid(self, state: State, geom: int, size: np.ndarray) -> list[Part]:
        kind, n_size = KINDS.get(mujoco.mjtGeom(self.model.geom_type[geom]), ("", 0))
        position = np.asarray(state.data.geom_xpos[geom], float)
        if not kind or position[2] < GONE:
            return []
        name = self.model.geom(geom).name or f"geom{geom}"
        rotation = np.asarray(state.data.geom_xmat[geom], float).reshape(3, 3)
        rgba: Colour = tuple(self.model.geom_rgba[geom].tolist())
        role = "object"
        if geom in self._slot_of:
            module, slot = self._slot_of[geom]
            if not state.world.active[module.kind][slot]:
                return []
            if module is self.agents:
                role = "agent" if geom == module.geom_ids[slot] else "hand"
                rgba = self._colour(state, slot)
            else:
                rgba = self.marks.tint(state, module, slot, rgba)
        elif kind == "box":
            role, rgba = "wall", palette.WALL
            if position[2] + size[2] > 2 * CUT:
                role, rgba = "high_wall", palette.HIGH_WALL
                position, size = np.append(position[:2], CUT / 2), np.append(size[:2], CUT / 2)
        mesh = int(self.model.geom_dataid[geom]) if kind == "mesh" else -1
        shape = Shape(kind, tuple(round(s, 4) for s in size[:n_size].tolist()), rgba, mesh)
        return [Part(name, role, shape, position, rotation)]

    def _sizes(self, state: State) -> np.ndarray:
        """(n_geoms, 3) of this world."""
        sizes = self.model.geom_size.copy()
        if "geom_size" in self.base.overlay:
            sizes[self.base.overlay["geom_size"]] = state.world.fields["geom_size"]
        return sizes

    def _doors(self, plan: Any) -> list[Part]:
        parts = []
        walls = np.asarray(plan.walls)
        for i in np.flatnonzero(np.asarray(plan.door_mask)):
            x, y, width = np.asarray(plan.doors[i], float)
            x0, y0, x1, y1 = walls.T
            along_x = ((np.abs((y0 + y1) / 2 - y) < 1e-3) & (x1 - x0 > y1 - y0)).any()
            half = (width / 2, 0.05) if along_x else (0.05, width / 2)
            shape = Shape("box", (*half, DOOR_HEIGHT / 2), palette.DOOR)
            parts.append(Part(f"door{i}", "door", shape, np.array([x, y, DOOR_HEIGHT / 2]), UPRIGHT))
        return parts

    def _sites(self, state: State) -> list[Part]:
        parts = []
        for kind, module in self.base.sites.items():
            extents = np.asarray(module.extents_of(state.world), float)
            for slot in np.flatnonzero(np.asarray(state.world.active[kind])):
                half = extents[slot] / 2
                flat = module.is_round and half[2] < half[0] / 2
                size = (half[0], half[2]) if flat else (half[0],) if module.is_round else tuple(half)
                rgba = module.rgba if self.flags is None or kind != "flag" else self.team_colour(int(slot))
                form = "cylinder" if flat else "sphere" if module.is_round else "box"
                shape = Shape(form, tuple(round(float(s), 4) for s in size), rgba)
                position = np.asarray(state.world.sites[kind][slot], float)
                parts.append(Part(module.names[slot], "site", shape, position, UPRIGHT))
        return parts

    def _headings(self, state: State) -> list[Line]:
        lines = []
        for agent in self.playing(state):
            centre = self.position(state, self.agents.body_ids[agent])
            front = turned(self.heading(state, agent))[:, 0]
            points = np.array([[centre, centre + 0.28 * front]])
            lines.append(Line(f"{self.agents.names[agent]}:heading", "heading", points, palette.DARK, 0.02))
        return lines

    def _text(self, state: State, returns: np.ndarray | None) -> list[str]:
        step = int(state.step)
        text = [f"{step * self.dt:.2f} s"]
        if self.preparation is not None and self.preparing(state):
            text[0] += f"   preparation, {(self.preparation.n_steps - step) * self.dt:.1f} s left"
        playing = self.playing(state)
        for team, name in enumerate(self.teams):
            members = playing[self.team[playing] == team]
            if not len(members):
                continue
            # Of a single team the sum says little: in tag it is zero.
            each = len(self.teams) == 1
            words = f"{name} {_numbers(state.reward, members, each)}"
            if returns is not None:
                words += f"   sum {_numbers(returns, members, each)}"
            text.append(words)
        return text + self.marks.words(state)


def _numbers(values: Any, members: np.ndarray, each: bool) -> str:
    """Some agents' rewards, each or all together."""
    own = np.asarray(values, float)[members]
    return " ".join(f"{round(value, 2) + 0.0:+g}" for value in (own if each else [own.sum()]))
