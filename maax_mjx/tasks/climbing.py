"""A scripted agent that locks boxes in their order, and gets into other rooms over ramps."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.tasks.carrying import (
    FASTEST,
    NO_ROOM,
    REACH,
    bring,
    footprints,
    in_hand,
    is_stuck,
    onward,
    turned,
    turning_place,
    without,
    wrapped,
)
from maax_mjx.tasks.walking import face, task_of, walk
from maax_mjx.wrappers import GrabObjects, LockObjects, LockTask
from maax_mjx.wrappers.enclosure import Footprints, walls_of
from maax_mjx.wrappers.reach import distance_to_objects

SPOTS = 15
"""Places along a wall at which a ramp may stand."""
CORNER = 0.3
"""Metres that these keep from the ends of the wall."""
AT_WALL = 0.31
"""Metres from a wall's middle line to the middle of a ramp that leads over it: half of both, and a little."""
BESIDE = 0.43
"""Metres from a ramp's middle where an agent stands to take hold of it, or to go up."""
SIDES = np.array([np.pi, -np.pi / 2, np.pi / 2, 0.0])
"""Where an agent may take hold, from the way up in radians: below, beside, above."""
DEARER = np.array([0.0, 2.0, 2.0, 3.0])
"""Metres that the agent walks rather than to take hold there."""
CROWDED = 6.0
"""Metres that it carries a ramp rather than where a metre of room is missing."""
SWEEP = 0.75
"""Metres around an agent that turns with a ramp in hand."""
TOP = 0.35
"""Metres from a ramp's middle to where an agent leaves it."""
UP, HIGH = 0.2, 0.5
"""Metres above the floor at which an agent's middle is on something, and high enough to go over a wall."""
STEEP = 0.8
"""Radians by which a ramp's way up may be off the way over the wall; further, it is put beside the wall."""
LOOSE, TIGHT = np.array([0.9, 0.6, 0.2, 0.37]), np.array([0.85, 0.5, 0.1, 0.34])
"""Radians off and metres from a wall's middle line, ahead and beside, at which a ramp leads over it; as it lies, and in
hand."""


class Wall(NamedTuple):
    """A wall between two rooms.

    Attributes:
        across: (2,) the direction from the one to the other.
        spots: (SPOTS, 2) metres, where the middle of a ramp may be.
        low, high: () metres, the ends along the wall.
        line: () metres across it, its middle line.
    """

    across: jax.Array
    spots: jax.Array
    low: jax.Array
    high: jax.Array
    line: jax.Array


def room_of(rooms: jax.Array, mask: jax.Array, points: jax.Array) -> jax.Array:
    """Returns the numbers (...) of the rooms that points (..., 2) are in, or nearest to.

    Args:
        rooms: (n, 4) x0, y0, x1, y1 in metres.
        mask: (n,) bool, which of them are there.
        points: metres.
    """
    to = points[..., None, :]
    beyond = jnp.maximum(jnp.maximum(rooms[:, :2] - to, to - rooms[:, 2:]), 0.0)
    return jnp.argmin(jnp.where(mask, jnp.linalg.norm(beyond, axis=-1), jnp.inf), axis=-1)


def wall_between(here: jax.Array, there: jax.Array) -> Wall:
    """Returns the wall between two rooms (4,) that are next to each other."""
    after, before = there[:2] - here[2:], here[:2] - there[2:]
    axis = jnp.argmax(jnp.maximum(after, before))
    sign = jnp.where(after[axis] > before[axis], 1.0, -1.0)
    line = jnp.where(sign > 0, here[2:] + there[:2], here[:2] + there[2:])[axis] / 2
    low, high = jnp.maximum(here[:2], there[:2])[1 - axis], jnp.minimum(here[2:], there[2:])[1 - axis]
    margin = jnp.minimum(CORNER, (high - low) / 2)
    along = jnp.linspace(low + margin, high - margin, SPOTS)
    across = jnp.zeros(2).at[axis].set(sign)
    is_axis = jnp.arange(2) == axis
    spots = jnp.where(is_axis, line - sign * AT_WALL, along[:, None])
    return Wall(across, spots, low, high, line)


class Ramp(NamedTuple):
    """A ramp, and what is around it.

    Attributes:
        at: (2,) metres, its middle.
        up: (2,) the direction in which it rises.
        turn: () radians by which it is to be turned to lead over the wall.
        things: what is in the way besides it.
    """

    at: jax.Array
    up: jax.Array
    turn: jax.Array
    things: Footprints


def sequential_lock(state: State, env: Environment, agent: int = 0) -> tuple[jax.Array, dict[str, Any]]:
    """Returns the actions of an agent that locks boxes in their order, and goes over walls to those in other rooms.

    It carries the ramp of the room that it is in to the wall, high edge or side first, locks it there, runs up, and
    steers over the wall as it flies off the top. It knows where everything is, and the order. The game is the published
    one; in it, without bins, the agent locks all boxes in about seven of ten worlds: elsewhere boxes that are locked
    are in the way of the ramp, or time runs out.

    Returns:
        Forces (3,); and "grab" and "lock", () {0, 1} each.

    Raises:
        ValueError: an environment that `check_sequential_lock` refuses.
    """
    check_sequential_lock(env)
    task, holds = task_of(env, LockTask, "sequential_lock"), task_of(env, GrabObjects, "sequential_lock")
    plan, boxes, ramps = state.world.plan, task.module, env.base.objects(("ramp",))[0]
    agents, locked = env.base.agents, state.mechanics["locks"].locked
    here, height = jnp.split(state.data.qpos[agents.qpos_ids[agent, :3]], [2])
    rooms = plan.rooms * (plan.floor_size / env.base.grid_size)
    target, is_done = jnp.maximum(state.mechanics[task.name].target, 0), state.mechanics[task.name].target < 0
    goal = state.data.qpos[boxes.qpos_ids[:, :2]][target]
    mine, its = (room_of(rooms, plan.room_mask, x) for x in (here, goal))
    wall = wall_between(rooms[mine], rooms[its])
    things = footprints(state, env, (boxes.kind, ramps.kind))
    number = jnp.arange(boxes.n_max + ramps.n_max)

    # The ramp of this room; one that leads over the wall already, if there is one.
    ramp_at, ramp_yaw = state.data.qpos[ramps.qpos_ids[:, :2]], state.data.qpos[ramps.qpos_ids[:, 3]]
    off = wrapped(jnp.arctan2(wall.across[1], wall.across[0]) + jnp.pi / 2 - ramp_yaw)
    ups = turned(jnp.array([0.0, -1.0]), ramp_yaw)
    in_room = (room_of(rooms, plan.room_mask, ramp_at) == mine) & state.world.active[ramps.kind]
    leads = in_room & _leads(wall, rooms[mine], ramp_at, ups, off, LOOSE)
    away = jnp.linalg.norm(ramp_at - here, axis=1) - 10.0 * leads
    chosen = jnp.argmin(jnp.where(in_room, away, jnp.inf))
    it = boxes.n_max + chosen
    turn = off[chosen] - jnp.sign(off[chosen]) * jnp.pi / 2
    turn = jnp.where(jnp.abs(off[chosen]) > STEEP, turn, 0.0)
    ramp = Ramp(ramp_at[chosen], ups[chosen], turn, without(things, number == it))
    kinds = [m.kind for m in holds.modules for _ in range(m.n_max)]
    first = kinds.index(ramps.kind)
    holding = state.mechanics[holds.name].held[agent] == first + chosen
    in_hand_leads = _leads(wall, rooms[mine], ramp.at, ramp.up, off[chosen], TIGHT)
    placed = jnp.where(holding, in_hand_leads, leads[chosen])

    spot = _spot(plan, wall, ramp)
    carry, drop = _carry(state, env, agent, wall, ramp, spot, rooms[mine], without(things, number >= boxes.n_max))
    fetch, at_grip = _fetch(state, env, agent, wall, ramp, things)
    at_grip &= ramp.things.clearance(here) > without(things, number != it).clearance(here)
    climb = _climb(state, env, agent, ramp, things, locked[it])
    is_apart, is_high = mine != its, height[0] > HIGH
    # Who hangs at the edge of the wall goes back for another run.
    is_still = jnp.linalg.norm(state.data.qvel[agents.qvel_ids[agent, :2]]) < 0.3
    over = jnp.append(jnp.where(is_still, -wall.across, wall.across), 0.0)
    crossing = jnp.where(is_high, over, jnp.where(placed, climb, jnp.where(holding, carry, fetch)))
    forces = jnp.where(
        is_apart, crossing, _looking(state, env, agent, goal, goal, without(things, number == target), 1.2)
    )
    forces = jnp.where(is_done, 0.0, forces)

    is_fetching = is_apart & ~placed & ~is_high & ~is_done
    gives_up = is_stuck(state, env, agent) & (state.step % 4 == 0)
    grab = is_fetching & ~locked[it] & jnp.where(holding, ~drop & ~gives_up, at_grip)
    # One choice for all in reach: a ramp that is to be moved must be open, a box that is locked must not come open.
    sees = state.mechanics["line_of_sight"][f"sees_{boxes.kind}"][agent]
    reached = (distance_to_objects(agents.body_ids, [boxes], state)[agent] <= REACH) & sees
    lock = ~is_fetching | (reached & (locked[: boxes.n_max] | (number[: boxes.n_max] == target))).any()
    return jnp.clip(forces, -1, 1), {"grab": grab.astype(jnp.int32), "lock": lock.astype(jnp.int32)}


def _spot(plan: RoomPlan, wall: Wall, ramp: Ramp) -> jax.Array:
    """Where at a wall a ramp is put (2,): near, with room for it and for the agent at its foot."""
    up, spots = turned(ramp.up, ramp.turn), wall.spots
    foot = spots - BESIDE * up
    crowded = jnp.maximum(0.36 - ramp.things.clearance(spots), 0) + jnp.maximum(0.2 - ramp.things.clearance(foot), 0)
    crowded += jnp.maximum(0.18 - walls_of(plan).clearance(foot), 0)
    top = (spots + TOP * up) @ jnp.abs(wall.across[::-1])
    crowded += 10.0 * ((top < wall.low + 0.15) | (top > wall.high - 0.15))
    between = ramp.at + jnp.linspace(0.2, 0.8, 4)[:, None, None] * (spots - ramp.at)
    crowded += 0.5 * jnp.maximum(0.36 - ramp.things.clearance(between), 0).max(axis=0)
    return spots[jnp.argmin(jnp.linalg.norm(spots - ramp.at, axis=1) + CROWDED * crowded)]


def _carry(
    state: State, env: Environment, agent: int, wall: Wall, ramp: Ramp, spot: jax.Array, room: jax.Array,
    boxes: Footprints,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """Forces (3,) of an agent that carries a ramp to a spot, and whether it would come between ramp and wall."""
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    on = onward(state.world.plan, ramp.at, spot, in_hand(boxes, state.world.plan, here - ramp.at, 0.08))
    pivot = turning_place(here, room, ramp.things, jnp.asarray(SWEEP))
    is_between = turned(here - ramp.at, ramp.turn) @ wall.across > 0.25
    is_there = (jnp.abs(ramp.turn) < 0.3) & (jnp.linalg.norm(ramp.at - spot) < 0.7)
    return bring(state, env, agent, ramp.at, on, ramp.turn, jnp.asarray(FASTEST), pivot), is_between & is_there


def _fetch(
    state: State, env: Environment, agent: int, wall: Wall, ramp: Ramp, things: Footprints
) -> tuple[jax.Array, jax.Array]:
    """Forces (3,) of an agent that goes where it can take hold of a ramp, and whether it is there."""
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    angles = jnp.arctan2(ramp.up[1], ramp.up[0]) + SIDES
    sides = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    grips = ramp.at + BESIDE * sides
    missing = jnp.maximum(0.3 - ramp.things.clearance(grips), 0)
    missing += jnp.maximum(0.17 - walls_of(state.world.plan).clearance(grips), 0)
    is_between = turned(sides, ramp.turn) @ wall.across > 0.5
    # Some chance, so that it tries another side where one leads nowhere.
    chance = jax.random.uniform(jax.random.fold_in(state.key, state.step // 12), (len(SIDES),))
    dear = jnp.linalg.norm(grips - here, axis=1) + DEARER + 5 * is_between + NO_ROOM * missing + 1.5 * chance
    grip = grips[jnp.argmin(dear)]
    return _looking(state, env, agent, grip, ramp.at, things, 0.8), jnp.linalg.norm(grip - here) < 0.1


def _climb(
    state: State, env: Environment, agent: int, ramp: Ramp, things: Footprints, is_locked: jax.Array
) -> jax.Array:
    """Forces (3,) of an agent that goes to the foot of a ramp, and up once it is locked."""
    here, height = jnp.split(state.data.qpos[env.base.agents.qpos_ids[agent, :3]], [2])
    side = jnp.array([-ramp.up[1], ramp.up[0]])
    below, beside = (here - ramp.at) @ ramp.up, (here - ramp.at) @ side
    in_line = (jnp.abs(beside) < 0.12) & (below < -0.1) & (below > -0.8)
    is_on = (height[0] > UP) & (jnp.abs(beside) < 0.3) & (jnp.abs(below) < 0.3)
    run = jnp.append(ramp.up - 3 * beside * side, 0.0)
    to_foot = _looking(state, env, agent, ramp.at - BESIDE * ramp.up, ramp.at, things, 0.8)
    return jnp.where(is_on | (in_line & is_locked), run, to_foot)


def _looking(
    state: State, env: Environment, agent: int, goal: jax.Array, at: jax.Array, things: Footprints, within: float
) -> jax.Array:
    """Forces (3,) of an agent that walks to a goal, and looks at a place once it is within some metres of that."""
    forces, to = walk(state, env, agent, goal, things), at - state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    return forces.at[2].set(jnp.where(jnp.linalg.norm(to) < within, face(state, env, agent, to), forces[2]))


def check_sequential_lock(env: Environment) -> None:
    """Refuses a game that the script cannot play.

    Raises:
        ValueError: an environment without `LockTask`, or without ramps that can be grabbed and locked.
    """
    task_of(env, LockTask, "sequential_lock")
    grabs, locks = task_of(env, GrabObjects, "sequential_lock"), task_of(env, LockObjects, "sequential_lock")
    for modules in (grabs.modules, locks.modules):
        if not any(m.kind == "ramp" and m.n_max for m in modules):
            raise ValueError("sequential_lock: got a game without ramps that can be grabbed and locked; takes ramps")


def _leads(wall: Wall, room: jax.Array, at: jax.Array, up: jax.Array, off: jax.Array, slack: np.ndarray) -> jax.Array:
    """Whether ramps at places (..., 2) that rise in a direction (..., 2), off by (...) radians, lead over a wall."""
    away = jnp.abs(wall.line - at @ jnp.abs(wall.across))
    top = (at + TOP * up) @ jnp.abs(wall.across[::-1])
    before = (top > wall.low + 0.1) & (top < wall.high - 0.1)
    ahead = (jnp.abs(off) < slack[0]) & (away < slack[1])
    beside = (jnp.abs(jnp.abs(off) - jnp.pi / 2) < slack[2]) & (away < slack[3])
    foot = at - BESIDE * up
    before &= ((foot > room[:2] + 0.1) & (foot < room[2:] - 0.1)).all(axis=-1)
    return before & (ahead | beside)
