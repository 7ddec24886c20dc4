"""What the mechanics add to a picture: locks, holds, flags, who is it, what agents see."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import jax
import numpy as np

from maax_mjx.common.checks import check_bool
from maax_mjx.core.state import State
from maax_mjx.modules import Entities, Flags, Ramps
from maax_mjx.viewer import palette
from maax_mjx.viewer.palette import Colour, blend
from maax_mjx.viewer.scene import UPRIGHT, Label, Line, Lock, Part, Shape, turned, up
from maax_mjx.wrappers import GrabObjects, Lidar, LineOfSight, LockObjects, Tag, find
from maax_mjx.wrappers.wrapper import Wrapper

if TYPE_CHECKING:
    from maax_mjx.viewer.stage import Stage

W = TypeVar("W", bound=Wrapper)

TINT = 0.4
"""How much of its owner's colour a locked object takes."""
CONE_REACH = 1.5
"""Metres to which vision cones are drawn; what agents see does not end there."""
CONE_OPACITY = 0.2
POLE = 0.7
HAND, BETWEEN, REACH = 0.05, 0.07, 0.19
"""Metres: a hand's radius, and where the two are of an agent that holds something."""


@dataclass
class Marked:
    """What the mechanics add to one picture."""

    parts: list[Part] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    locks: list[Lock] = field(default_factory=list)


class Marks:
    """The marks of one environment's states.

    Args:
        stage: whose.
        vision: whether to show who sees where and whom.
        lidar: whether to show lidar rays.

    Raises:
        ValueError: a sense that the environment does not have.
    """

    def __init__(self, stage: Stage, *, vision: bool, lidar: bool):
        self._stage = stage
        env = stage.env
        self._locking, self._grabbing, self._tag = find(env, LockObjects), find(env, GrabObjects), find(env, Tag)
        self._sight = _needed("vision", check_bool("vision", vision), find(env, LineOfSight))
        self._lidar = _needed("lidar", check_bool("lidar", lidar), find(env, Lidar))
        self._cast = jax.jit(self._lidar.rays) if self._lidar is not None else None
        self._lockable = _slots(self._locking)
        self._grabbable = _slots(self._grabbing)

    def __call__(self, state: State) -> Marked:
        """What there is to mark in a state of a single world, on the host."""
        marked = Marked()
        self._eyes(state, marked)
        self._locked(state, marked)
        self._held(state, marked)
        self._who_is_it(state, marked)
        self._flags(state, marked)
        self._seen(state, marked)
        self._rays(state, marked)
        self._slopes(state, marked)
        return marked

    def tint(self, state: State, module: Entities, slot: int, rgba: Colour) -> Colour:
        """The colour of an object, with some of its owner's where it is locked."""
        owner = self._owners(state).get((module.kind, slot), -1)
        return rgba if owner < 0 else blend(rgba, self._stage.colours[owner], TINT)

    def words(self, state: State) -> list[str]:
        """What is to be said of the game, besides the time and the rewards."""
        game = self._stage.flags
        if game is None:
            return []
        score = np.asarray(state.mechanics[game.name].score)
        return ["score " + " : ".join(str(int(value)) for value in score)]

    def _owners(self, state: State) -> dict[tuple[str, int], int]:
        """By (kind, slot), who locked what is locked and in play."""
        if self._locking is None:
            return {}
        owners = np.asarray(state.mechanics[self._locking.name].owner)
        return {
            (module.kind, slot): int(owner)
            for (module, slot), owner in zip(self._lockable, owners, strict=True)
            if owner >= 0 and state.world.active[module.kind][slot]
        }

    def _top(self, state: State, module: Entities, slot: int) -> np.ndarray:
        """(3,) metres: the middle of the upper side of an object, however it is turned."""
        body = module.body_ids[slot]
        extents = np.asarray(module.extents_of(state.world), float)
        w, x, y, z = np.asarray(state.data.xquat[body], float)
        top = np.abs([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        height = float(top @ extents[slot]) / 2
        return self._stage.position(state, body) + up(height)

    def _eyes(self, state: State, marked: Marked) -> None:
        stage = self._stage
        for agent in stage.playing(state):
            name, centre = stage.agents.names[agent], stage.position(state, stage.agents.body_ids[agent])
            rotation = turned(stage.heading(state, agent))
            for side, sign in (("left", 1), ("right", -1)):
                position = centre + rotation @ [0.117, 0.058 * sign, 0.075]
                shape = Shape("sphere", (0.028,), palette.EYE)
                marked.parts.append(Part(f"{name}:eye_{side}", "eye", shape, position, UPRIGHT))
            colour = stage.colours[agent]
            marked.labels.append(Label(f"{name}:number", str(agent), centre + up(0.26), colour))

    def _locked(self, state: State, marked: Marked) -> None:
        modules = {module.kind: module for module, _ in self._lockable}
        for (kind, slot), owner in self._owners(state).items():
            module = modules[kind]
            top, colour = self._top(state, module, slot), self._stage.colours[owner]
            marked.locks.append(Lock(module.names[slot], owner, top, colour))
            marked.parts.extend(_padlock(f"{module.names[slot]}:lock", top + up(0.03), colour))
            marked.labels.append(Label(f"{module.names[slot]}:owner", str(owner), top + up(0.36), colour))

    def _held(self, state: State, marked: Marked) -> None:
        if self._grabbing is None:
            return
        stage = self._stage
        held = np.asarray(state.mechanics[self._grabbing.name].held)
        for agent in stage.playing(state):
            if held[agent] < 0:
                continue
            module, slot = self._grabbable[held[agent]]
            name, here = stage.agents.names[agent], stage.position(state, stage.agents.body_ids[agent])
            to = stage.position(state, module.body_ids[slot]) - here
            reach = turned(float(np.arctan2(to[1], to[0])))
            hands = [part for part in ("left", "right") if f"{name}:hand_{part}" in stage.geom_names]
            for side in hands:
                position = here + reach @ [REACH, BETWEEN * (1 if side == "left" else -1), 0.0]
                shape = Shape("sphere", (HAND,), stage.colours[agent])
                marked.parts.append(Part(f"{name}:hand_{side}", "hand", shape, position, UPRIGHT))
            # Over the object's upper side, and down to the agent.
            there = self._top(state, module, slot) + up(0.03)
            above = np.array([here[0], here[1], max(there[2], here[2] + 0.16)])
            ends = np.array([[above, there], [above, here + up(0.14)]])
            marked.lines.append(Line(f"{name}:hold", "hold", ends, palette.DARK, 0.035))

    def _who_is_it(self, state: State, marked: Marked) -> None:
        if self._tag is None:
            return
        stage = self._stage
        it = int(state.mechanics[self._tag.name].it)
        above = stage.position(state, stage.agents.body_ids[it]) + up(0.2)
        shape = Shape("cylinder", (0.1, 0.03), palette.IT)
        marked.parts.append(Part("it", "it", shape, above, UPRIGHT))

    def _flags(self, state: State, marked: Marked) -> None:
        stage = self._stage
        if stage.flags is None:
            return
        carriers = np.asarray(state.mechanics[stage.flags.name].carrier)
        for team, carrier in enumerate(carriers):
            foot = np.asarray(state.world.sites[Flags.kind][team], float)
            if carrier >= 0:
                foot = stage.position(state, stage.agents.body_ids[carrier]) + up(0.1)
            pole = Shape("cylinder", (0.015, POLE / 2), palette.DARK)
            cloth = Shape("box", (0.16, 0.01, 0.1), stage.team_colour(team))
            parts = [(pole, [0, 0, POLE / 2]), (cloth, [0.16, 0, POLE - 0.1])]
            for i, (shape, at) in enumerate(parts):
                name = f"flag{team}:{('pole', 'cloth')[i]}"
                marked.parts.append(Part(name, "flag", shape, foot + at, UPRIGHT))

    def _seen(self, state: State, marked: Marked) -> None:
        if self._sight is None:
            return
        stage = self._stage
        sees = np.asarray(state.mechanics[self._sight.name]["sees_agents"])
        for agent in stage.playing(state):
            # Agents see themselves unless they see nothing at all.
            if not sees[agent, agent]:
                continue
            name, here = stage.agents.names[agent], stage.position(state, stage.agents.body_ids[agent])
            rgba = (*stage.colours[agent][:3], CONE_OPACITY)
            shape = Shape("sector", (CONE_REACH, float(self._sight.half_cone)), rgba)
            # Cones that overlap lie at different heights.
            on_floor = np.array([here[0], here[1], 0.012 + 0.003 * agent])
            marked.parts.append(Part(f"{name}:cone", "cone", shape, on_floor, turned(stage.heading(state, agent))))
            others = [i for i in np.flatnonzero(sees[agent]) if stage.team[i] != stage.team[agent]]
            if others:
                ends = np.array([[here, stage.position(state, stage.agents.body_ids[i])] for i in others])
                marked.lines.append(Line(f"{name}:sight", "sight", ends, stage.colours[agent], 0.02))

    def _rays(self, state: State, marked: Marked) -> None:
        if self._cast is None:
            return
        stage = self._stage
        directions, distances = (np.asarray(x, float) for x in jax.device_get(self._cast(state)))
        for agent in stage.playing(state):
            here = stage.position(state, stage.agents.body_ids[agent])
            ends = here + directions[agent] * distances[agent][:, None]
            points = np.stack([np.broadcast_to(here, ends.shape), ends], axis=1)
            rgba = (*stage.colours[agent][:3], 0.6)
            marked.lines.append(Line(f"{stage.agents.names[agent]}:rays", "ray", points, rgba, 0.008))

    def _slopes(self, state: State, marked: Marked) -> None:
        """An arrow up every ramp, whose slope is hard to see from some sides."""
        stage = self._stage
        for module in stage.base.modules.values():
            if not isinstance(module, Ramps):
                continue
            for slot in np.flatnonzero(np.asarray(state.world.active[module.kind])):
                geom = int(module.geom_ids[slot])
                rotation = np.asarray(state.data.geom_xmat[geom], float).reshape(3, 3)
                corners = stage.meshes[int(stage.model.geom_dataid[geom])][0] @ rotation.T
                corners += np.asarray(state.data.geom_xpos[geom], float)
                foot, tip = uphill(corners)
                side = np.cross(tip - foot, corners.mean(axis=0) - foot)
                side *= 0.12 / max(float(np.linalg.norm(side)), 1e-9)
                back = foot + 0.6 * (tip - foot)
                points = np.array([[foot, tip], [tip, back + side], [tip, back - side]])
                marked.lines.append(Line(f"{module.names[slot]}:slope", "slope", points, palette.DARK, 0.024))


def uphill(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) foot and (3,) tip of an arrow on the slope of a wedge, from its corners (n, 3) in metres."""
    upper = np.unique(corners[corners[:, 2] > corners[:, 2].mean()].round(4), axis=0)
    lower = np.unique(corners[corners[:, 2] <= corners[:, 2].mean()].round(4), axis=0)
    top = upper.mean(axis=0)
    # Of the lower corners, the two that are furthest from the upper edge.
    away = np.linalg.norm((lower - top)[:, :2], axis=1)
    bottom = lower[np.argsort(away)[-2:]].mean(axis=0)
    way, lift = top - bottom, up(0.012)
    return bottom + 0.2 * way + lift, bottom + 0.8 * way + lift


def _padlock(name: str, foot: np.ndarray, rgba: Colour) -> list[Part]:
    """A padlock that stands on a place, and faces -y."""
    body, side, top = (0.1, 0.045, 0.075), (0.016, 0.016, 0.05), (0.076, 0.016, 0.016)
    boxes = [
        ("body", body, [0, 0, body[2]], rgba),
        ("left", side, [-0.06, 0, 0.2], palette.DARK),
        ("right", side, [0.06, 0, 0.2], palette.DARK),
        ("top", top, [0, 0, 0.25], palette.DARK),
        ("keyhole", (0.018, 0.004, 0.03), [0, -body[1], body[2]], palette.DARK),
    ]
    return [Part(f"{name}:{part}", "lock", Shape("box", size, of), foot + at, UPRIGHT) for part, size, at, of in boxes]


def _slots(wrapper: LockObjects | GrabObjects | None) -> list[tuple[Entities, int]]:
    """(module, slot) of what a mechanic is about, in its order."""
    modules = [] if wrapper is None else wrapper.modules
    return [(module, slot) for module in modules for slot in range(module.n_max)]


def _needed(name: str, asked: bool, found: W | None) -> W | None:
    if asked and found is None:
        needs = {"vision": "LineOfSight", "lidar": "Lidar"}[name]
        raise ValueError(f"{name}: got True, and env has no {needs}; wrap it with {needs}(env), or leave it out")
    return found if asked else None
