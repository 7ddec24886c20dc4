"""The stage: what is to be seen of a state of an environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from maax_mjx.common.checks import check_bool
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import WallScenarios
from maax_mjx.viewer.canvas import Canvas, Marked
from maax_mjx.viewer.marks import draw_agents, draw_slopes, marks_for
from maax_mjx.viewer.materials import Paint
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
            int(body): (module, int(slot))
            for module in self._base.movables
            for body, slot in zip(module.all_body_ids, module.slot_of_body, strict=True)
        }
        walls = [module for module in self._base.modules.values() if isinstance(module, WallScenarios)]
        self._walls = {int(geom): i for module in walls for i, geom in enumerate(module.geom_ids)}
        self._floor = self.subject.materials.of_geom(int(self._base.floor_id[0])).rgba

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
        sites = [*self._sites(state, marked), *self._sites_of_bodies(state)]
        parts = [*self._doors(plan), *solids, *sites, *marked.parts]
        text = [*self._text(state, marked, returns), *marked.words]
        return Frame(float(plan.floor_size), self._floor, parts, marked.lines, marked.labels, text)

    def _marked(self, state: State) -> Marked:
        """Marks of the agents, the ramps and the mechanics."""
        marked = Marked()
        for draw in (draw_agents, draw_slopes):
            draw(state, Canvas(self.subject, state, marked))
        for mark in self._marks:
            try:
                mark.draw(state, Canvas(self.subject, state, marked, mark.layer))
            except Exception as error:  # of a user's function, whatever it may be
                said = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
                raise ValueError(f"marks of {mark.layer!r}: {said}") from error
        return marked

    def _solid(self, state: State, marked: Marked, geom: int, size: np.ndarray) -> list[Part]:
        """A geom, unless this world does not have it."""
        kind, n_size = KINDS.get(mujoco.mjtGeom(self.model.geom_type[geom]), ("", 0))
        position = np.asarray(state.data.geom_xpos[geom], float)
        paint, body = self.subject.materials.of_geom(geom), int(self.model.geom_bodyid[geom])
        if not kind or not self._is_seen(state, body, position, paint):
            return []
        name = self.model.geom(geom).name or f"geom{geom}"
        rotation = np.asarray(state.data.geom_xmat[geom], float).reshape(3, 3)
        role = "object"
        if body in self._slot_of:
            module, slot = self._slot_of[body]
            if module is self._agents:
                role = "agent" if geom == module.geom_ids[slot] else "hand"
                paint = Paint(self.subject.colours[slot])
            paint = paint._replace(rgba=marked.tinted(module.kind, slot, paint.rgba))
        elif geom in self._walls:
            role, paint = "wall", Paint(WALL)
            position, size = _as_planned(position, size, np.asarray(state.world.plan.walls[self._walls[geom]], float))
            if position[2] + size[2] > 2 * CUT:
                role, paint = "high_wall", Paint(HIGH_WALL)
                position, size = np.append(position[:2], CUT / 2), np.append(size[:2], CUT / 2)
        mesh = int(self.model.geom_dataid[geom]) if kind == "mesh" else -1
        shape = Shape(kind, _rounded(size[:n_size]), paint.rgba, mesh, paint.material)
        # A hand that holds something is where its mark says.
        instead = marked.replaced.get(name)
        return [instead._replace(role=role) if instead else Part(name, role, shape, position, rotation)]

    def _is_seen(self, state: State, body: int, position: np.ndarray, paint: Paint) -> bool:
        """Whether this world has a geom or site, and it is not wholly transparent."""
        if body in self._slot_of:
            module, slot = self._slot_of[body]
            if not state.world.active[module.kind][slot]:
                return False
        return bool(position[2] >= GONE and paint.rgba[3] > 0)

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
                shape = Shape(form, _rounded(size), rgba)
                position = np.asarray(state.world.sites[kind][slot], float)
                parts.append(Part(module.names[slot], "site", shape, position, UPRIGHT))
        return parts

    def _sites_of_bodies(self, state: State) -> list[Part]:
        """The model's own sites, which are where their bodies are; those of `Sites` lie far below."""
        parts = []
        for site in range(self.model.nsite):
            kind, n_size = KINDS[mujoco.mjtGeom(self.model.site_type[site])]
            body = int(self.model.site_bodyid[site])
            turn = _rotation(state.data.xquat[body])
            position = np.asarray(state.data.xpos[body], float) + turn @ self.model.site_pos[site]
            paint = self.subject.materials.of_site(site)
            if self._is_seen(state, body, position, paint):
                shape = Shape(kind, _rounded(self.model.site_size[site, :n_size]), paint.rgba, -1, paint.material)
                rotation = turn @ _rotation(self.model.site_quat[site])
                name = self.model.site(site).name or f"site{site}"
                parts.append(Part(f"{name}:site", "mark", shape, position, rotation))
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


def _as_planned(position: np.ndarray, size: np.ndarray, rect: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and half extents of a wall of the plan (4,): in the physics outer walls reach further out."""
    low, high = rect[:2], rect[2:]
    return np.append((low + high) / 2, position[2]), np.append((high - low) / 2, size[2])


def _rounded(size: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    """The numbers of a size, equal in all frames of what has the same."""
    return tuple(round(float(s), 4) for s in size)


def _rotation(quat: Any) -> np.ndarray:
    """(3, 3) rotation of a quaternion (4,), w first."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat, float))
    return matrix.reshape(3, 3)


def _numbers(values: Any, members: np.ndarray, each: bool) -> str:
    """Some agents' rewards, each or all together."""
    own = np.asarray(values, float)[members]
    return " ".join(f"{round(value, 2) + 0.0:+g}" for value in (own if each else [own.sum()]))
