"""A scripted agent that locks boxes in their order, and gets into other rooms over ramps."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.tasks.carrying import FASTEST, bring, footprints, turned, wrapped
from maax_mjx.tasks.walking import face, next_step, task_of, walk
from maax_mjx.wrappers import GrabObjects, LockTask
from maax_mjx.wrappers.enclosure import Footprints, walls_of
from maax_mjx.wrappers.reach import distance_to_objects

SPOTS = 15
"""Places along a wall at which a ramp may stand."""
CORNER = 0.3
"""Metres that these keep from the ends of the wall."""
AT_WALL = 0.31
"""Metres from a wall's middle line to the middle of a ramp that leads over it: half of both, and a little."""
BEFORE = 0.55
"""Metres further away where a ramp is turned before it is put against the wall."""
BESIDE = 0.43
"""Metres from a ramp's middle where an agent stands to take hold of it, or to go up."""
REACH = 0.25
"""Metres from an agent's middle within which it locks."""
SIDES = np.array([np.pi, -np.pi / 2, np.pi / 2, 0.0])
"""Where an agent may take hold, from the way up in radians: below, beside, above."""
DEARER = np.array([0.0, 2.0, 2.0, 3.0])
"""Metres that the agent walks rather than to take hold there."""
NO_ROOM = 20.0
"""Metres that it walks rather than to go where there is no room."""
SWEEP = 0.75
"""Metres from walls at which an agent turns with a ramp in hand."""
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


def sequential_lock(state: State, env: Environment, agent: int = 0) -> tuple[jax.Array, dict[str, Any]]:
    """Returns the actions of an agent that locks boxes in their order, and goes over walls to those in other rooms.

    It carries the ramp of the room in which it is to the wall, its high edge first, and runs up. It knows where
    everything is, and in which order boxes are to be locked.

    Returns:
        Forces (3,); and "grab" and "lock", () {0, 1} each.

    Raises:
        ValueError: an environment without `LockTask`, or without ramps that can be grabbed.
    """
    task = task_of(env, LockTask, "sequential_lock")
    holds = task_of(env, GrabObjects, "sequential_lock")
    plan, boxes, ramps = state.world.plan, task.module, env.base.modules["ramp"]
    agents = env.base.agents
    here, height = state.data.qpos[agents.qpos_ids[agent, :2]], state.data.qpos[agents.qpos_ids[agent, 2]]
    rooms = plan.rooms * (plan.floor_size / env.base.grid_size)
    target = jnp.maximum(state.mechanics[task.name].target, 0)
    is_done = state.mechanics[task.name].target < 0
    box_at = state.data.qpos[boxes.qpos_ids[:, :2]]
    ramp_at, ramp_yaw = state.data.qpos[ramps.qpos_ids[:, :2]], state.data.qpos[ramps.qpos_ids[:, 3]]
    mine, its = (room_of(rooms, plan.room_mask, x) for x in (here, box_at[target]))
    wall = wall_between(rooms[mine], rooms[its])

    things = footprints(state, env, (boxes.kind, ramps.kind))
    solid = jnp.arange(boxes.n_max + ramps.n_max)

    # To a box in the same room.
    others = _without(things, solid == target)
    straight = walk(state, env, agent, box_at[target], others)
    near = jnp.linalg.norm(box_at[target] - here) < 1.2
    to_box = straight.at[2].set(jnp.where(near, face(state, env, agent, box_at[target] - here), straight[2]))

    # The ramp of this room: where it leads over the wall.
    in_room = (room_of(rooms, plan.room_mask, ramp_at) == mine) & state.world.active[ramps.kind]
    off_wall = wrapped(jnp.arctan2(wall.across[1], wall.across[0]) + jnp.pi / 2 - ramp_yaw)
    ups = turned(jnp.array([0.0, -1.0]), ramp_yaw)
    leads = in_room & _leads(wall, rooms[mine], ramp_at, ups, off_wall, LOOSE)
    ramp = jnp.argmin(jnp.where(in_room, jnp.linalg.norm(ramp_at - here, axis=1) - 10.0 * leads, jnp.inf))
    offset = sum(m.n_max for m in holds.modules[: [m.kind for m in holds.modules].index(ramps.kind)])
    held = state.mechanics[holds.name].held[agent]
    holding = held == offset + ramp
    at, up, off = ramp_at[ramp], ups[ramp], off_wall[ramp]
    placed = jnp.where(holding, _leads(wall, rooms[mine], at, up, off, TIGHT), leads[ramp])
    is_locked = state.mechanics["locks"].locked[boxes.n_max + ramp]
    obstacles = _without(things, solid == boxes.n_max + ramp)

    # To the wall with it.
    flush = jnp.abs(off) > STEEP
    turn = jnp.where(flush, off - jnp.sign(off) * jnp.pi / 2, 0.0)
    later = turned(up, turn)
    spots = wall.spots
    foot = spots - BESIDE * later
    crowded = jnp.maximum(0.36 - obstacles.clearance(spots), 0) + jnp.maximum(0.2 - obstacles.clearance(foot), 0)
    crowded += jnp.maximum(0.18 - _walls(plan).clearance(foot), 0)
    top = (spots + 0.35 * later) @ jnp.abs(wall.across[::-1])
    crowded += 10.0 * ((top < wall.low + 0.15) | (top > wall.high - 0.15))
    ways_there = at + jnp.linspace(0.2, 0.8, 4)[:, None, None] * (spots - at)
    crowded += 0.5 * jnp.maximum(0.36 - obstacles.clearance(ways_there), 0).max(axis=0)
    cost = jnp.linalg.norm(spots - at, axis=1) + 6 * crowded
    spot = spots[jnp.argmin(cost)]
    within = rooms[mine] + SWEEP * jnp.array([1.0, 1.0, -1.0, -1.0])
    in_hand = _in_hand(_without(things, solid >= boxes.n_max), plan, here - at)
    to, straight = next_step(plan, at, spot, in_hand)
    onward = at + jnp.where(straight, to, to / jnp.maximum(jnp.linalg.norm(to), 1e-6) * 0.7)
    carry = bring(state, env, agent, at, onward, turn, jnp.asarray(FASTEST), within)

    # To where it can be taken hold of.
    angles = jnp.arctan2(up[1], up[0]) + SIDES
    sides = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    grips = at + BESIDE * sides
    missing = jnp.maximum(0.3 - obstacles.clearance(grips), 0) + jnp.maximum(0.17 - _walls(plan).clearance(grips), 0)
    in_between = turned(sides, turn) @ wall.across > 0.5
    noise = jax.random.uniform(jax.random.fold_in(state.key, state.step // 12), (len(SIDES) + SPOTS,))
    dear = (
        jnp.linalg.norm(grips - here, axis=1) + DEARER + 5 * in_between + NO_ROOM * missing + 1.5 * noise[: len(SIDES)]
    )
    grip = grips[jnp.argmin(dear)]
    fetch = walk(state, env, agent, grip, things)
    to_ramp = face(state, env, agent, at - here)
    is_near = jnp.linalg.norm(at - here) < 0.8
    fetch = fetch.at[2].set(jnp.where(is_near, to_ramp, fetch[2]))
    at_grip = jnp.linalg.norm(grip - here) < 0.1
    at_grip &= obstacles.clearance(here) > _without(things, solid != boxes.n_max + ramp).clearance(here)
    between = turned(here - at, turn) @ wall.across > 0.25
    drop = between & (jnp.abs(turn) < 0.3) & (jnp.linalg.norm(at - spot) < 0.7)

    # Up the ramp, and from its top over the wall.
    below = (here - at) @ up
    beside = (here - at) @ jnp.array([-up[1], up[0]])
    in_line = (jnp.abs(beside) < 0.12) & (below < -0.1) & (below > -0.8)
    on_ramp = (height > UP) & (jnp.abs(beside) < 0.3) & (jnp.abs(below) < 0.3)
    run = jnp.append(up - 3 * beside * jnp.array([-up[1], up[0]]), 0.0)
    to_foot = walk(state, env, agent, at - BESIDE * up, things)
    to_foot = to_foot.at[2].set(jnp.where(is_near, to_ramp, to_foot[2]))
    climb = jnp.where(on_ramp | (in_line & is_locked), run, to_foot)
    over = jnp.append(wall.across, 0.0)

    apart, is_high = mine != its, height > HIGH
    crossing = jnp.where(placed, climb, jnp.where(holding, carry, fetch))
    drift = jnp.linalg.norm(state.data.qvel[agents.qvel_ids[agent, :2]])
    crossing = jnp.where(is_high, jnp.where(drift < 0.3, -over, over), crossing)
    forces = jnp.where(is_done, 0.0, jnp.where(apart, crossing, to_box))
    own = agents.qvel_ids[agent]
    speed = jnp.linalg.norm(state.data.qvel[own[:2]]) + jnp.abs(state.data.qvel[own[3]])
    stuck = holding & (speed < 0.15) & (state.step % 4 == 0)
    fetches = apart & ~placed & ~is_high & ~is_done
    grab = fetches & ~is_locked & jnp.where(holding, ~drop & ~stuck, at_grip)

    sees = state.mechanics["line_of_sight"][f"sees_{boxes.kind}"][agent]
    reached = (distance_to_objects(agents.body_ids, [boxes], state)[agent] <= REACH) & sees
    locked = state.mechanics["locks"].locked[: boxes.n_max]
    lock = ~fetches | (reached & (locked | (jnp.arange(boxes.n_max) == target))).any()
    return jnp.clip(forces, -1, 1), {"grab": grab.astype(jnp.int32), "lock": lock.astype(jnp.int32)}


def _leads(wall: Wall, room: jax.Array, at: jax.Array, up: jax.Array, off: jax.Array, slack: jax.Array) -> jax.Array:
    """Whether ramps at places (..., 2) that rise in a direction (..., 2), off by (...) radians, lead over a wall."""
    away = jnp.abs(wall.line - at @ jnp.abs(wall.across))
    top = (at + 0.35 * up) @ jnp.abs(wall.across[::-1])
    before = (top > wall.low + 0.1) & (top < wall.high - 0.1)
    ahead = (jnp.abs(off) < slack[0]) & (away < slack[1])
    beside = (jnp.abs(jnp.abs(off) - jnp.pi / 2) < slack[2]) & (away < slack[3])
    foot = at - BESIDE * up
    before &= ((foot > room[:2] + 0.1) & (foot < room[2:] - 0.1)).all(axis=-1)
    return before & (ahead | beside)


def _in_hand(things: Footprints, plan: RoomPlan, off: jax.Array) -> Footprints:
    """What is in the way of a ramp whose agent stands `off` (2,) metres from it, for an agent in the ramp's place."""
    walls = walls_of(plan)
    parts = [
        things._replace(half=jnp.where(things.half > 0, things.half + 0.08, 0.0)),
        things._replace(centre=things.centre - off),
        walls._replace(centre=walls.centre - off, half=jnp.where(walls.half > 0, walls.half - 0.02, 0.0)),
    ]
    return Footprints(*(jnp.concatenate(x) for x in zip(*parts, strict=True)))


def _walls(plan):
    return walls_of(plan)


def _without(things: Footprints, out: jax.Array) -> Footprints:
    """Returns footprints without some of them."""
    return things._replace(half=jnp.where(out[:, None], 0.0, things.half))
