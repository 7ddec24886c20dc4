"""A scripted agent that puts boxes around a cylinder."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks.carrying import REACH, drive, footprints, is_stuck, joined, turned, turning_place, without, wrapped
from maax_mjx.tasks.walking import CELLS, face, task_of, walk, ways
from maax_mjx.wrappers import GrabObjects, LockObjects, ShelterReward
from maax_mjx.wrappers.enclosure import Footprints

LONG, THIN, CUBE = 1.65, 0.15, 0.5
"""Metres of the boxes."""
GAP = 0.07
"""Metres between the cylinder and the nearest places of boxes."""
BEHIND = np.array([0.0, 0.3, 0.6])
"""Metres by which places are further away than the nearest."""
TURNS = 48
"""Directions from the cylinder in which there are places."""
STANDS = np.array([0.0, np.pi / 2, -np.pi / 2])
"""Radians from the direction away from the cylinder to where the agent stands, seen from the box."""
BESIDE = 0.18
"""Metres from a box's face to the middle of an agent that takes hold there."""
ROOM, EDGE, KEPT = 0.02, 0.12, 0.28
"""Metres that boxes in their places keep from others, and boxes and agents' middles from the edges of the floor."""
WALK, CARRY, TURN = 2.8, 1.8, 4.0
"""Metres per second on the way to a box and with one in hand, and radians per second, as they are reckoned with."""
TAKE, SHOVE = 0.7, 0.8
"""Seconds that it takes to take hold and let go, and to get past a box that is in the way."""
WORTH = 3.0
"""Rays that are worth a second."""
LEAST = 2
"""Rays to be gained, below which a box is left where it is."""
FAR = 20.0
"""Metres that count for what cannot be reached."""
FASTEST = 3.5
"""Metres per second at most with a box in hand."""
ALONG = 0.6
"""Radians around the cylinder by which it looks ahead."""
WIDE, WIDER, WIDEST = 0.9, 0.3, 0.5
"""Metres further out for a radian around the cylinder that is left, for one that is to be turned, and at most."""
FITS, TURNED = 0.1, 0.15
"""Metres and radians from its place at which a box is let go."""
NEAR = 1.0
"""Metres from the cylinder to the middles of boxes that are locked."""
ASKEW, SWEEP = 0.6, 1.0
"""Radians by which a long box is turned where there is room for it, and metres around the agent that it takes."""
PIVOT, SHORT = 3.0, 15.0
"""Seconds that this takes, and metres that the agent goes rather than to turn where a metre of room is missing."""
PULL_EVERY, PULLS, PULL, TOUCH = 14, 5, 0.7, 0.06
"""Steps of which in the first ones a long box is pulled from the cylinder, how many, how far in metres, and the metres
from the cylinder within which it is."""
PATIENCE, CHANCE, LEFT = 40, 4.0, 0.3
"""Steps after which it thinks anew, rays that chance is worth then, and the share of boxes that it leaves alone."""


class Places(NamedTuple):
    """Where boxes may go.

    Attributes:
        boxes: (m,) footprints there, whose x axes point away from the cylinder.
        out: (m,) radians of these.
        stops: (m, r) bool, the rays that end there.
        is_long: (m,) bool, whether it is for a long box.
    """

    boxes: Footprints
    out: jax.Array
    stops: jax.Array
    is_long: np.ndarray


class Way(NamedTuple):
    """Where a box in hand goes.

    Attributes:
        goal: (2,) metres, of the box's middle.
        out: () radians, the direction from the cylinder to the goal.
        turn: () radians by which the box is still to be turned.
        middle: (2,) metres, of the cylinder.
        radius: () metres, of the cylinder.
        pivot: (2,) metres, where the agent turns with a long box.
    """

    goal: jax.Array
    out: jax.Array
    turn: jax.Array
    middle: jax.Array
    radius: jax.Array
    pivot: jax.Array


def shelter(state: State, env: Environment, agent: int = 0) -> tuple[jax.Array, dict[str, Any]]:
    """Returns the actions of an agent that brings boxes to where they keep most rays from the cylinder.

    It knows where everything is. Of 52 rays at the start it leaves 28 in the published time of 240 steps, and at most
    half in 55 % of worlds (of 96); in twice the time 16 (of 32): long boxes jam at the cylinder and at other boxes.

    Returns:
        Forces (3,); and "grab" and "lock", () {0, 1} each.

    Raises:
        ValueError: an environment that `check_shelter` refuses.
    """
    check_shelter(env)
    task = task_of(env, ShelterReward, "shelter")
    boxes, floor = env.base.objects(("box",))[0], state.world.plan.floor_size
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    middle = state.data.geom_xpos[task.cylinders.geom_ids[0], :2]
    radius = state.world.extents[task.cylinders.kind][0, 0] / 2
    starts, cylinder = jnp.asarray(task.starts[:, :2]), _disc(middle, radius)
    things, numbers = footprints(state, env, (boxes.kind,)), jnp.arange(boxes.n_max)
    yaw, held = state.data.qpos[boxes.qpos_ids[:, 3]], state.mechanics["grabs"].held[agent]
    holding = held >= 0

    places = places_around(middle, radius, starts)
    free = _free(places, things, floor)
    gain = jnp.where(free.any(axis=0), _gains(places, things, starts, middle), -jnp.inf)
    seconds = _seconds(state, places, things, yaw, middle, here, joined(things, cylinder), held)
    # Some chance, which ends what leads nowhere.
    chance = jax.random.uniform(jax.random.fold_in(state.key, state.step // PATIENCE), (len(numbers),))
    anew = (gain >= LEAST) & ((chance > LEFT) | (state.step < PATIENCE))[:, None] & ~_are_in(places, things, yaw)
    wanted = jnp.where(holding, (numbers == held)[:, None], anew)
    score = gain[..., None] - WORTH * seconds.min(axis=0) + jnp.where(holding, 0.0, CHANCE * chance)[:, None, None]
    score = jnp.where(wanted[..., None] & jnp.moveaxis(free, 0, 2), score, -jnp.inf)
    box, place, stand = jnp.unravel_index(jnp.argmax(score), score.shape)
    is_done = ~jnp.isfinite(score.max())

    others, it = without(things, numbers == box), jax.tree.map(lambda x: x[box], things)
    side = yaw[box] + jnp.argmin(seconds[:, box, place, stand]) * (jnp.pi / 2)
    fetch, at_grip = _fetch(state, env, agent, it, side, joined(things, cylinder))
    at_grip &= others.clearance(here) > without(things, numbers != box).clearance(here)
    goal, out = places.boxes.centre[place], places.out[place]
    within = jnp.concatenate([jnp.full(2, EDGE), jnp.full(2, floor - EDGE)])
    pivot = turning_place(here, within, joined(others, cylinder), jnp.asarray(SWEEP), SHORT)
    turn = wrapped(out + jnp.asarray(STANDS)[stand] - side)
    carry, turn = _carry(state, env, agent, it, Way(goal, out, turn, middle, radius, pivot))

    there = (jnp.linalg.norm(goal - it.centre) < FITS) & (jnp.abs(turn) < TURNED)
    gives_up = (is_stuck(state, env, agent) & (state.step % 4 == 0)) | (state.step % PATIENCE == 0)
    keeps = ~there & (gain[box, place] > 0) & ~gives_up
    grab = ~is_done & jnp.where(holding, keeps, at_grip)
    forces = jnp.where(is_done, 0.0, jnp.where(holding, carry, fetch))
    # One choice for all in reach: what is placed is locked unless that would lock something else.
    in_reach = jax.vmap(lambda x: without(things, numbers != x).clearance(here))(numbers) < REACH
    placed = (gain.max(axis=1) < LEAST) & (jnp.linalg.norm(things.centre - middle, axis=1) < radius + NEAR)
    lock = (in_reach & placed).any() & ~(in_reach & ~placed).any()
    return jnp.clip(forces, -1, 1), {"grab": grab.astype(jnp.int32), "lock": lock.astype(jnp.int32)}


def places_around(middle: jax.Array, radius: jax.Array, starts: jax.Array) -> Places:
    """Returns the places around a cylinder.

    Args:
        middle: (2,) metres, of the cylinder.
        radius: () metres.
        starts: (r, 2) metres, where rays begin.
    """
    out = np.arange(TURNS) * (2 * np.pi / TURNS)
    is_long, behind, out = (x.reshape(-1) for x in np.meshgrid([False, True], BEHIND, out, indexing="ij"))
    half = np.where(is_long[:, None], [THIN / 2, LONG / 2], CUBE / 2)
    u = np.stack([np.cos(out), np.sin(out)], axis=1)
    centre = middle + u * (radius + GAP + behind + half[:, 0])[:, None]
    there = Footprints(centre, jnp.asarray(half), jnp.asarray(u))
    return Places(there, jnp.asarray(out), stopped(there, starts, middle), is_long)


def stopped(things: Footprints, starts: jax.Array, middle: jax.Array) -> jax.Array:
    """Returns which things stop which rays (r, 2) to a point (2,): (n, r) bool."""

    def one(thing: Footprints) -> jax.Array:
        back = -jnp.arctan2(thing.turn[1], thing.turn[0])
        from_, way = turned(starts - thing.centre, back), turned(middle - starts, back)
        way = jnp.where(jnp.abs(way) < 1e-6, 1e-6, way)
        ends = jnp.stack([(-thing.half - from_) / way, (thing.half - from_) / way])
        first, last = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        return (last > jnp.maximum(first, 0.0)) & (first < 1.0) & (thing.half > 0).all()

    return jax.vmap(one)(things)


def _gains(places: Places, things: Footprints, starts: jax.Array, middle: jax.Array) -> jax.Array:
    """How many more rays are stopped if a box goes to a place: (n, m), -inf where it does not fit."""
    stops = stopped(things, starts, middle)
    # Rays that no other box stops.
    mine = (stops.sum(axis=0) - stops) == 0
    gain = mine.astype(jnp.float32) @ places.stops.T.astype(jnp.float32) - (mine & stops).sum(axis=1)[:, None]
    is_long = things.half.max(axis=1) > CUBE
    return jnp.where((is_long[:, None] == places.is_long) & (things.half > 0).all(axis=1)[:, None], gain, -jnp.inf)


def _are_in(places: Places, things: Footprints, yaw: jax.Array) -> jax.Array:
    """Which boxes are in which places: (n, m) bool."""
    period = jnp.where(things.half.max(axis=1) > CUBE, jnp.pi, jnp.pi / 2)[:, None]
    off = yaw[:, None] + jnp.where(things.half[:, :1] > things.half[:, 1:], jnp.pi / 2, 0.0) - places.out
    off = jnp.abs(off - period * jnp.round(off / period))
    return (jnp.linalg.norm(things.centre[:, None] - places.boxes.centre, axis=-1) < FITS + 0.03) & (off < TURNED + 0.1)


def _free(places: Places, things: Footprints, floor: jax.Array) -> jax.Array:
    """Whether there is room for a box in a place and an agent beside it: (stands, n, m) bool."""
    there = places.boxes
    u = there.turn
    aside = jnp.stack([-u[:, 1], u[:, 0]], axis=1)
    grid = np.stack(np.meshgrid([-1.0, 1.0], np.linspace(-1, 1, 7), indexing="ij"), axis=-1).reshape(-1, 2)
    at = grid * there.half[:, None]
    points = there.centre[:, None] + at[..., :1] * u[:, None] + at[..., 1:] * aside[:, None]
    stands = jnp.stack([
        there.centre + (there.half[:, :1] + BESIDE) * u,
        there.centre + (there.half[:, 1:] + BESIDE) * aside,
        there.centre - (there.half[:, 1:] + BESIDE) * aside,
    ])  # fmt: skip
    inside = jnp.minimum(points, floor - points).min(axis=(1, 2)) > EDGE
    inside = inside & (jnp.minimum(stands, floor - stands).min(axis=2) > KEPT)

    def apart(thing: Footprints) -> jax.Array:
        one = jax.tree.map(lambda x: x[None], thing)
        return (one.clearance(points).min(axis=1) > ROOM) & (one.clearance(stands) > 0.15)

    close = ~jax.vmap(apart)(things)
    # By others than the box itself.
    return jnp.moveaxis((close.sum(axis=0) - close) == 0, 1, 0) & inside[:, None]


def _seconds(
    state: State, places: Places, things: Footprints, yaw: jax.Array, middle: jax.Array, here: jax.Array,
    in_way: Footprints, held: jax.Array,
) -> jax.Array:  # fmt: skip
    """How long it takes to bring boxes to places, by where it takes hold and stands then: (4, n, m, stands)."""
    plan, numbers = state.world.plan, jnp.arange(len(yaw))
    far = ways(plan, here, in_way)
    sides = yaw + jnp.arange(4)[:, None] * (jnp.pi / 2)
    normals = jnp.stack([jnp.cos(sides), jnp.sin(sides)], axis=-1)
    depth = jnp.tile(things.half.T, (2, 1))
    grips = things.centre + (depth + BESIDE + 0.05)[..., None] * normals
    cells = jnp.clip((grips / (plan.floor_size / CELLS)).astype(jnp.int32), 0, CELLS - 1)
    walking = jnp.minimum(far[cells[..., 0], cells[..., 1]], FAR) / WALK
    beyond = jnp.einsum("snj,nj->sn", normals, here - things.centre) - depth
    is_held_so = jnp.where(jnp.arange(4)[:, None] == jnp.argmax(beyond, axis=0), 0.0, jnp.inf)
    walking = jnp.where(numbers == held, is_held_so, walking + TAKE)

    turns = wrapped(places.out[:, None] + STANDS - sides[..., None, None])
    from_, to = things.centre - middle, places.boxes.centre - middle
    angle, away = jnp.arctan2(from_[:, 1], from_[:, 0]), jnp.linalg.norm(from_, axis=1)
    around = wrapped(places.out - angle[:, None])
    there = jnp.linalg.norm(to, axis=1)
    metres = jnp.abs(away[:, None] - there) + jnp.minimum(away[:, None], there + 0.3) * jnp.abs(around)
    # Boxes between, which are passed on the way around.
    along = wrapped(angle - angle[:, None])[:, None] * jnp.sign(around)[..., None]
    between = (along > 0) & (along < jnp.abs(around)[..., None]) & (away < 2.2)
    between &= (numbers != numbers[:, None])[:, None]
    carrying = metres / CARRY + SHOVE * between.sum(axis=-1)
    is_long = things.half.max(axis=1) > CUBE
    is_askew = is_long[:, None, None] & (jnp.abs(turns) > ASKEW)
    at_end = (depth > CUBE)[..., None, None]
    turning = jnp.abs(turns) / TURN + jnp.where(is_askew, jnp.where(at_end, jnp.inf, PIVOT), 0.0)
    return walking[..., None, None] + carrying[..., None] + turning


def _fetch(
    state: State, env: Environment, agent: int, box: Footprints, side: jax.Array, things: Footprints
) -> tuple[jax.Array, jax.Array]:
    """Forces (3,) of an agent that goes where it can take hold of a box, and whether it is there."""
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    normal = jnp.stack([jnp.cos(side), jnp.sin(side)])
    grip = box.centre + (_depth(box, side) + BESIDE) * normal
    forces, left = walk(state, env, agent, grip, things), jnp.linalg.norm(grip - here)
    looking = forces.at[2].set(face(state, env, agent, box.centre - here))
    return jnp.where(left < 0.6, looking, forces), left < 0.12


def _carry(state: State, env: Environment, agent: int, box: Footprints, way: Way) -> tuple[jax.Array, jax.Array]:
    """Forces (3,) of an agent that brings a box around the cylinder to its place, and radians left to turn."""
    here, floor = state.data.qpos[env.base.agents.qpos_ids[agent, :2]], state.world.plan.floor_size
    from_, is_long = box.centre - way.middle, box.half.max() > CUBE
    angle, away = jnp.arctan2(from_[1], from_[0]), jnp.linalg.norm(from_)
    around = wrapped(way.out - angle)
    # On the way, cubes are turned as they would be at the cylinder there; long boxes at once as they are to lie.
    turn = jnp.where(is_long, way.turn, wrapped(way.turn - around + jnp.clip(around, -0.3, 0.3)))
    wider = jnp.minimum(WIDE * jnp.abs(around) + WIDER * jnp.abs(turn), WIDEST)
    ahead = angle + jnp.clip(around, -ALONG, ALONG)
    u = jnp.stack([jnp.cos(ahead), jnp.sin(ahead)])
    following = way.middle + (jnp.linalg.norm(way.goal - way.middle) + wider) * u
    final = following - turned(box.centre - here, turn)
    is_askew = is_long & (jnp.abs(turn) > ASKEW)
    final = jnp.where(is_askew, way.pivot, final)
    # The end of a long box does not slide along the cylinder: now and then it is pulled away.
    jams = is_long & (away < way.radius + _depth(box, angle) + TOUCH) & (is_askew | (jnp.abs(around) > 0.3))
    pulls = jams & (state.step % PULL_EVERY < PULLS)
    final = jnp.where(pulls, here + PULL * from_ / away, final)
    now = jnp.where(pulls | (is_askew & (jnp.linalg.norm(way.pivot - here) > 0.1)), 0.0, turn)
    return drive(state, env, agent, jnp.clip(final, KEPT, floor - KEPT) - here, now, FASTEST), turn


def _depth(box: Footprints, direction: jax.Array) -> jax.Array:
    """Metres from a box's middle to the furthest that it goes in a direction in radians."""
    off = direction - jnp.arctan2(box.turn[1], box.turn[0])
    return jnp.abs(jnp.stack([jnp.cos(off), jnp.sin(off)])) @ box.half


def check_shelter(env: Environment) -> None:
    """Refuses a game that the script cannot play.

    Raises:
        ValueError: an environment without `ShelterReward`, or without boxes that can be grabbed and locked.
    """
    for wrapper in (ShelterReward, GrabObjects, LockObjects):
        task_of(env, wrapper, "shelter")


def _disc(middle: jax.Array, radius: jax.Array) -> Footprints:
    """A disc, as three squares within it."""
    angles = jnp.arange(3) * (jnp.pi / 6)
    half = jnp.broadcast_to(radius * np.sqrt(0.5), (3, 2))
    return Footprints(jnp.broadcast_to(middle, (3, 2)), half, jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1))
