"""A scripted agent that puts boxes around a cylinder."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks.carrying import footprints, is_stuck, joined, swing, turned, without, wrapped
from maax_mjx.tasks.shading import BESIDE, CUBE, EDGE, KEPT, STANDS, TURNS, Places, free, gains, is_long, places_around
from maax_mjx.tasks.walking import CELLS, face, go, step_along, task_of, ways
from maax_mjx.wrappers import GrabObjects, ShelterReward
from maax_mjx.wrappers.enclosure import Footprints

WALK, CARRY, TURN = 3.0, 2.0, 3.0
"""Metres per second on the way to a box and with one in hand, and radians per second, as they are reckoned with."""
TAKE, SHOVE, SQUEEZE = 0.7, 0.5, 5.0
"""Seconds that it takes to take hold and let go, to get past a box that is in the way, and through a narrow passage."""
WORTH = 3.0
"""Rays that are worth a second."""
LEAST, RISK, PACE = 2.0, 0.1, 0.3
"""Rays to be gained, below which a box is left where it is; and more of them for a ray that only this box stops, which
may be lost, and for a second with the box in hand."""
BARRED = 40.0
"""Metres that count for what cannot be reached unless boxes are pushed aside."""
PUSH, FASTEST = 0.8, 3.5
"""Share of full force on the way to a box, and metres per second at most with one in hand."""
LOOKING, TAKES = 0.6, 0.12
"""Metres from where it takes hold within which it looks at the box, and takes hold."""
ALONG, TURNING = 0.6, 1.0
"""Radians around the cylinder, and of turning, by which it looks ahead with a box in hand."""
CLEAR, OUT = 0.08, 0.06
"""Metres kept from the cylinder on the way, and by which a box is too near to something to be turned."""
NEAR, BACK, AHEAD, ALMOST = 0.6, 0.3, 1.0, 0.4
"""Metres from the cylinder within which boxes are passed behind them; radians around it behind the box in hand and
ahead of it where they are, and those from its place where they no longer count."""
BESIDE_WAY = 1.2
"""Metres from the cylinder within which boxes are in the way around it."""
PASSAGE = 0.55
"""Metres that a long box and its agent take between the cylinder and a wall."""
BODY = 0.16
"""Metres, the radius of an agent, and a little."""
ASKEW = 0.6
"""Radians by which a long box that is held at its end is turned at most."""
PATIENCE, CHANCE, LEFT = 40, 4.0, 0.3
"""Steps after which it thinks anew, rays that chance is worth then, and the share of boxes that it leaves alone."""
GIVE_UP = 0.1
"""Share of the steps without motion at which it lets go of a box."""


class Way(NamedTuple):
    """Where a box in hand goes.

    Attributes:
        goal: (2,) metres, of the box's middle.
        around: () radians around the cylinder to the goal.
        turn: () radians by which the box is still to be turned.
        middle: (2,) metres, of the cylinder.
        radius: () metres, of the cylinder.
    """

    goal: jax.Array
    around: jax.Array
    turn: jax.Array
    middle: jax.Array
    radius: jax.Array


def shelter(state: State, env: Environment, agent: int = 0) -> tuple[jax.Array, dict[str, Any]]:
    """Returns the actions of an agent that brings boxes to where they keep most rays from the cylinder.

    It knows where everything is; see `docs/games.md` for how many rays it leaves.

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
    gain, alone = gains(places, things, starts, middle)
    around, on_way = _ways_around(places, things, middle, radius, floor)
    far = ways(state.world.plan, here, joined(things, cylinder))
    seconds = on_way[..., None] + _seconds(places, things, yaw, here, far, floor, held, around)
    # Some chance, which ends what leads nowhere.
    chance = jax.random.uniform(jax.random.fold_in(state.key, state.step // PATIENCE), (len(numbers),))
    anew = (chance > LEFT) | (state.step < PATIENCE)
    least = LEAST + jnp.where(holding, 0.0, RISK * alone)[:, None]
    wanted = (gain >= least + PACE * on_way) & jnp.where(holding, numbers == held, anew)[:, None]
    score = gain[..., None] - WORTH * seconds.min(axis=0) + jnp.where(holding, 0.0, CHANCE * chance)[:, None, None]
    score = jnp.where(wanted[..., None] & free(places, things, floor), score, -jnp.inf)
    box, place, stand = jnp.unravel_index(jnp.argmax(score), score.shape)
    is_done = ~jnp.isfinite(score.max())

    others, it = without(things, numbers == box), jax.tree.map(lambda x: x[box], things)
    side = yaw[box] + jnp.argmin(seconds[:, box, place, stand]) * (jnp.pi / 2)
    fetch, at_grip = _fetch(state, env, agent, it, side, far)
    at_grip &= others.clearance(here) > without(things, numbers != box).clearance(here)
    turn = wrapped(jnp.asarray(places.out)[place] + jnp.asarray(STANDS)[stand] - side)
    way = Way(places.boxes.centre[place], around[box, place], turn, middle, radius)
    carry = _carry(state, env, agent, it, others, way)

    luck = jax.random.uniform(jax.random.fold_in(state.key, state.step))
    gives_up = (is_stuck(state, env, agent) & (luck < GIVE_UP)) | (state.step % PATIENCE == 0)
    grab = ~is_done & jnp.where(holding, ~gives_up, at_grip)
    forces = jnp.where(is_done, 0.0, jnp.where(holding, carry, fetch))
    return jnp.clip(forces, -1, 1), {"grab": grab.astype(jnp.int32), "lock": jnp.zeros((), jnp.int32)}


def _ways_around(
    places: Places, things: Footprints, middle: jax.Array, radius: jax.Array, floor: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Radians around the cylinder from boxes to places (n, m), the quicker way round, and the seconds that it takes."""
    step = 2 * np.pi / TURNS
    from_, to = things.centre - middle, places.boxes.centre - middle
    away, there = jnp.linalg.norm(from_, axis=1)[:, None], jnp.linalg.norm(to, axis=1)
    angle = jnp.arctan2(from_[:, 1], from_[:, 0])
    # Seconds that it takes to get past what stands in a direction: boxes near the cylinder, and walls close to it.
    directions = np.arange(TURNS) * step
    u = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    passage = middle + (radius + PASSAGE) * u
    is_shut = jnp.minimum(passage, floor - passage).min(axis=1) < EDGE
    at = jnp.round(angle / step).astype(jnp.int32) % TURNS
    is_near = (away[:, 0] < radius + BESIDE_WAY) & (things.half > 0).all(axis=1)
    boxes = jnp.where(is_near, SHOVE, 0.0)[:, None] * (at[:, None] == np.arange(TURNS))
    passed = jnp.cumsum(jnp.tile(boxes.sum(axis=0) + SQUEEZE * is_shut, 2))
    first, last = at[:, None], jnp.asarray(np.round(places.out / step).astype(int) % TURNS)
    left, right = (last - first) % TURNS, (first - last) % TURNS
    # Strictly between.
    over = [
        jnp.where(left > 1, passed[first + jnp.maximum(left, 1) - 1] - passed[first], 0.0),
        jnp.where(right > 1, passed[last + jnp.maximum(right, 1) - 1] - passed[last], 0.0),
    ]
    around = jnp.asarray(places.out) - angle[:, None]
    arcs = [around % (2 * np.pi), -around % (2 * np.pi)]
    far = [(arc * jnp.minimum(away, there + 0.3) / CARRY + cost) for arc, cost in zip(arcs, over, strict=True)]
    quicker = jnp.where(far[0] < far[1], arcs[0], -arcs[1])
    return quicker, jnp.minimum(*far) + jnp.abs(away - there) / CARRY


def _seconds(
    places: Places, things: Footprints, yaw: jax.Array, here: jax.Array, far: jax.Array, floor: jax.Array,
    held: jax.Array, around: jax.Array,
) -> jax.Array:  # fmt: skip
    """How long it takes to take hold of boxes and to turn them: (4 sides, n, m, stands); infinite where it cannot."""
    sides = yaw + jnp.arange(4)[:, None] * (jnp.pi / 2)
    normals = jnp.stack([jnp.cos(sides), jnp.sin(sides)], axis=-1)
    depth = jnp.tile(things.half.T, (2, 1))
    grips = things.centre + (depth + BESIDE + 0.05)[..., None] * normals
    cells = jnp.clip((grips / (floor / CELLS)).astype(jnp.int32), 0, CELLS - 1)
    barred = jnp.where(jnp.minimum(grips, floor - grips).min(axis=-1) > KEPT, BARRED, jnp.inf)
    walking = jnp.minimum(far[cells[..., 0], cells[..., 1]], barred) / WALK + TAKE
    beyond = jnp.einsum("snj,nj->sn", normals, here - things.centre) - depth
    is_held_so = jnp.where(jnp.arange(4)[:, None] == jnp.argmax(beyond, axis=0), 0.0, jnp.inf)
    walking = jnp.where(jnp.arange(len(yaw)) == held, is_held_so, walking)
    turns = wrapped(jnp.asarray(places.out)[:, None] + STANDS - sides[..., None, None])
    turns = jnp.maximum(jnp.abs(turns), jnp.abs(wrapped(turns - around[..., None])))
    at_end = (depth > CUBE)[..., None, None]
    # Held at its end, a long box is not swung around; and it is to lie across, not to point at the cylinder.
    is_askew = at_end & (turns > ASKEW) | is_long(things)[:, None, None] & (at_end != (STANDS != 0.0))
    return walking[..., None, None] + jnp.where(is_askew, jnp.inf, turns / TURN)


def _fetch(
    state: State, env: Environment, agent: int, box: Footprints, side: jax.Array, far: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Forces (3,) of an agent that goes where it can take hold of a box, and whether it is there."""
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    normal = jnp.stack([jnp.cos(side), jnp.sin(side)])
    grip = box.centre + (_depth(box, side) + BESIDE) * normal
    to, near = step_along(far, state.world.plan.floor_size, here, grip)
    forces, left = go(state, env, agent, to, near, PUSH), jnp.linalg.norm(grip - here)
    looking = forces.at[2].set(face(state, env, agent, box.centre - here))
    return jnp.where(left < LOOKING, looking, forces), left < TAKES


def _carry(state: State, env: Environment, agent: int, box: Footprints, others: Footprints, way: Way) -> jax.Array:
    """Forces (3,) of an agent that brings a box around the cylinder to its place."""
    here, floor = state.data.qpos[env.base.agents.qpos_ids[agent, :2]], state.world.plan.floor_size
    from_ = box.centre - way.middle
    angle, away = jnp.arctan2(from_[1], from_[0]), jnp.linalg.norm(from_)
    ahead = jnp.clip(way.around, -ALONG, ALONG)
    # On the way, it is turned as it would be at the cylinder there.
    turn = jnp.clip(wrapped(way.turn - way.around + ahead), -TURNING, TURNING)
    turns = jnp.linspace(0.0, 1.0, 5) * turn
    agents = turned(here - box.centre, turns)

    def reach(direction: jax.Array | float) -> jax.Array:
        """How far box and agent reach from the box's middle while they turn."""
        u = jnp.stack([jnp.cos(direction), jnp.sin(direction)])
        return jnp.maximum(_depth(box, direction - turns), agents @ u + BODY).max()

    inward = reach(angle + jnp.pi)
    nearest = way.radius + inward + CLEAR
    behind = _behind(others, way, angle) + inward
    far = jnp.maximum(jnp.linalg.norm(way.goal - way.middle), jnp.maximum(nearest, behind))
    low = EDGE + jnp.stack([reach(jnp.pi), reach(-jnp.pi / 2)])
    high = floor - EDGE - jnp.stack([reach(0.0), reach(jnp.pi / 2)])
    to = way.middle + far * jnp.stack([jnp.cos(angle + ahead), jnp.sin(angle + ahead)])
    # Between the walls and off the cylinder, along the wall where the cylinder is near it.
    for _ in range(4):
        to = jnp.clip(to, jnp.minimum(low, high), jnp.maximum(low, high)) - way.middle
        to = way.middle + to * jnp.maximum(nearest / jnp.linalg.norm(to), 1.0)
    # It is turned where there is room for that.
    has_room = (away > nearest - OUT) & ((box.centre > low - OUT) & (box.centre < high + OUT)).all()
    turn = jnp.where(has_room | is_stuck(state, env, agent), turn, 0.0)
    return swing(state, env, agent, box, to - box.centre, turn, FASTEST)


def _behind(others: Footprints, way: Way, angle: jax.Array) -> jax.Array:
    """Metres from the cylinder's middle to the outer sides of boxes at it which are on the way around from an angle."""
    there = others.centre - way.middle
    angles, away = jnp.arctan2(there[:, 1], there[:, 0]), jnp.linalg.norm(there, axis=1)
    depth, around = jax.vmap(_depth)(others, angles), jnp.abs(way.around)
    along = wrapped(angles - angle) * jnp.sign(way.around)
    passes = (along > -BACK) & (along < jnp.minimum(around, AHEAD)) & (around > ALMOST)
    passes &= (away - depth < way.radius + NEAR) & (others.half > 0).all(axis=1)
    return jnp.where(passes, away + depth, -jnp.inf).max()


def _depth(box: Footprints, direction: jax.Array) -> jax.Array:
    """Metres from a box's middle to the furthest that it goes in directions (...) in radians."""
    off = direction - jnp.arctan2(box.turn[1], box.turn[0])
    return jnp.abs(jnp.stack([jnp.cos(off), jnp.sin(off)], axis=-1)) @ box.half


def check_shelter(env: Environment) -> None:
    """Refuses a game that the script cannot play.

    Raises:
        ValueError: an environment without `ShelterReward`, or without boxes that can be grabbed.
    """
    for wrapper in (ShelterReward, GrabObjects):
        task_of(env, wrapper, "shelter")


def _disc(middle: jax.Array, radius: jax.Array) -> Footprints:
    """A disc, as three squares within it."""
    angles = jnp.arange(3) * (jnp.pi / 6)
    half = jnp.broadcast_to(radius * np.sqrt(0.5), (3, 2))
    return Footprints(jnp.broadcast_to(middle, (3, 2)), half, jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1))
