"""The stage: what is to be seen of a state of an environment."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from maax_mjx.common.checks import check_bool
from maax_mjx.common.colours import Colour
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.viewer.canvas import Canvas, Marked
from maax_mjx.viewer.marks import draw_agents, draw_slopes, marks_for
from maax_mjx.viewer.palette import DOOR, HIGH_WALL, WALL
from maax_mjx.viewer.scene import UPRIGHT, Frame, Part, Shape
from maax_mjx.viewer.subject import Subject

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


class Stage:
    """Looks at the states of one environment.

    Args:
        env: the environment.
        vision: whether to show who sees where and whom; needs `LineOfSight`.
        lidar: whether to show the rays of `Lidar`, which it needs.

    Attributes:
        subject: the model, its agents and their teams.

    Raises:
        ValueError: no environment, or a sense that it does not have.
    """

    def __init__(self, env: Environment, *, vision: bool = False, lidar: bool = False):
        self.subject = Subject(env)
        self._base, self._agents = self.subject.base, self.subject.agents
        asked = {"vision": check_bool("vision", vision), "lidar": check_bool("lidar", lidar)}
        self._marks = marks_for(env, [sense for sense, wanted in asked.items() if wanted])
        self._slot_of = {
            int(geom): (module, int(slot))
            for module in self._base.modules.values()
            if isinstance(module, Entities) and module.n_max
            for geom, slot in zip(module.all_geom_ids, module.slot_of_geom, strict=True)
        }

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.subject.model

    @property
    def meshes(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Vertices (n, 3) in metres and faces (m, 3), by the numbers of the meshes in the model."""
        return self.subject.meshes

    @property
    def dt(self) -> float:
        """Seconds of one env step."""
        return self._base.dt

    def frame(self, state: State, returns: np.ndarray | None = None) -> Frame:
        """The frame of a state.

        Args:
            state: of a single world, on the host.
            returns: (n_agents,) reward summed over the running episode, where it is known.
        """
        plan, marked = state.world.plan, self._marked(state)
        sizes = self._sizes(state)
        solids = [part for geom in range(self.model.ngeom) for part in self._solid(state, marked, geom, sizes[geom])]
        parts = [*self._doors(plan), *solids, *self._sites(state, marked), *marked.parts]
        text = [*self._text(state, marked, returns), *marked.words]
        return Frame(float(plan.floor_size), parts, marked.lines, marked.labels, text)

    def _marked(self, state: State) -> Marked:
        """Marks of the agents, the ramps and the mechanics."""
        marked = Marked()
        for draw in (draw_agents, draw_slopes):
            draw(state, Canvas(self.subject, state, marked))
        for mark in self._marks:
            mark.draw(state, Canvas(self.subject, state, marked, mark.layer))
        return marked

    def _solid(self, state: State, marked: Marked, geom: int, size: np.ndarray) -> list[Part]:
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
            if module is self._agents:
                role, rgba = "agent" if geom == module.geom_ids[slot] else "hand", self.subject.colours[slot]
            rgba = marked.tinted(module.kind, slot, rgba)
        elif kind == "box":
            role, rgba = "wall", WALL
            if position[2] + size[2] > 2 * CUT:
                role, rgba = "high_wall", HIGH_WALL
                position, size = np.append(position[:2], CUT / 2), np.append(size[:2], CUT / 2)
        mesh = int(self.model.geom_dataid[geom]) if kind == "mesh" else -1
        shape = Shape(kind, tuple(round(s, 4) for s in size[:n_size].tolist()), rgba, mesh)
        # A hand that holds something is where its mark says.
        instead = marked.replaced.get(name)
        return [instead._replace(role=role) if instead else Part(name, role, shape, position, rotation)]

    def _sizes(self, state: State) -> np.ndarray:
        """(n_geoms, 3) of this world."""
        sizes = self.model.geom_size.copy()
        if "geom_size" in self._base.overlay:
            sizes[self._base.overlay["geom_size"]] = state.world.fields["geom_size"]
        return sizes

    def _doors(self, plan: Any) -> list[Part]:
        parts = []
        walls = np.asarray(plan.walls)
        for i in np.flatnonzero(np.asarray(plan.door_mask)):
            x, y, width = np.asarray(plan.doors[i], float)
            x0, y0, x1, y1 = walls.T
            along_x = ((np.abs((y0 + y1) / 2 - y) < 1e-3) & (x1 - x0 > y1 - y0)).any()
            half = (width / 2, 0.05) if along_x else (0.05, width / 2)
            shape = Shape("box", (*half, DOOR_HEIGHT / 2), DOOR)
            parts.append(Part(f"door{i}", "door", shape, np.array([x, y, DOOR_HEIGHT / 2]), UPRIGHT))
        return parts

    def _sites(self, state: State, marked: Marked) -> list[Part]:
        parts = []
        for kind, module in self._base.sites.items():
            extents = np.asarray(module.extents_of(state.world), float)
            for slot in np.flatnonzero(np.asarray(state.world.active[kind])):
                half = extents[slot] / 2
                flat = module.is_round and half[2] < half[0] / 2
                size = (half[0], half[2]) if flat else (half[0],) if module.is_round else tuple(half)
                rgba = marked.tinted(kind, int(slot), module.rgba)
                form = "cylinder" if flat else "sphere" if module.is_round else "box"
                shape = Shape(form, tuple(round(float(s), 4) for s in size), rgba)
                position = np.asarray(state.world.sites[kind][slot], float)
                parts.append(Part(module.names[slot], "site", shape, position, UPRIGHT))
        return parts

    def _text(self, state: State, marked: Marked, returns: np.ndarray | None) -> list[str]:
        """The time, and what every team gets."""
        text = ["   ".join([f"{int(state.step) * self.dt:.2f} s", *marked.notes])]
        teams, playing = self.subject.teams, self.subject.playing(state)
        for name, team in teams.items():
            members = playing[np.isin(playing, team.slots)]
            if not len(members):
                continue
            # Of a single team the sum says little: in tag it is zero.
            each = len(teams) == 1
            words = f"{name} {_numbers(state.reward, members, each)}"
            if returns is not None:
                words += f"   sum {_numbers(returns, members, each)}"
            text.append(words)
        return text


def _numbers(values: Any, members: np.ndarray, each: bool) -> str:
    """Some agents' rewards, each or all together."""
    own = np.asarray(values, float)[members]
    return " ".join(f"{round(value, 2) + 0.0:+g}" for value in (own if each else [own.sum()]))
