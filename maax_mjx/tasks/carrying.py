"""What scripted agents do with a thing in hand: they bring it to a place, turned as it is to be."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.tasks.walking import next_step
from maax_mjx.wrappers.enclosure import Footprints, walls_of

RATE, FASTEST = 5.0, 3.5
"""Metres per second for a metre that is missing, and at most."""
TURN_RATE, TURN_FASTEST = 4.0, 4.0
"""Radians per second for a radian that is missing, and at most."""
DRAG, PUSH, FRICTION = 0.11, 0.2, 0.2
"""Shares of full force for a metre per second, for one that is missing, and against friction."""
TURN_DRAG, TURN_PUSH, TURN_FRICTION = 0.11, 0.03, 0.04
"""Shares of full torque likewise, for radians."""
ASKEW = 0.3
"""Radians by which a thing is turned on the way; by more, it is turned where there is room."""
PLACES, SHORT = 8, 6.0
"""Places along an edge of a room that are looked at for turning, and metres that an agent goes for one of room."""
SLIM = 0.02
"""Metres that an agent with a thing in hand goes nearer to walls."""
NO_ROOM, AHEAD = 20.0, 0.7
"""Metres that an agent goes rather than to where a metre of room is missing, and metres by which it looks ahead."""
REACH = 0.25
"""Metres from an agent's middle within which it locks."""
SLIDE = 0.11
"""Share of full force against the friction of an agent, and of a box."""
TWIST, LEVEL = 0.15, 0.04
"""Share of full torque against the friction of a box that turns, for a metre from its middle to its corners, and
radians off below which it is left."""
STILL = 0.01
"""Metres and radians off below which friction is left to hold a thing."""


def onward(plan: RoomPlan, thing: jax.Array, goal: jax.Array, things: Footprints) -> jax.Array:
    """Returns where a thing in hand is brought next (2,) in metres, on the way to a goal.

    Args:
        plan: of the rooms.
        thing: (2,) metres, where the thing is.
        goal: (2,) metres.
        things: what is in the way, see `in_hand`.
    """
    to, straight = next_step(plan, thing, goal, things)
    return thing + jnp.where(straight, to, to / jnp.maximum(jnp.linalg.norm(to), 1e-6) * AHEAD)


def turned(vector: jax.Array, angle: jax.Array) -> jax.Array:
    """Returns vectors (..., 2), turned by angles (...)."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def wrapped(angle: jax.Array) -> jax.Array:
    """Returns angles in [-pi, pi]."""
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))


def bring(
    state: State,
    env: Environment,
    agent: int,
    thing: jax.Array,
    goal: jax.Array,
    turn: jax.Array,
    fastest: jax.Array,
    pivot: jax.Array,
) -> jax.Array:
    """Returns forces (3,) of an agent that brings what it holds straight to a place, and turns it elsewhere first.

    Args:
        state, env, agent: who acts.
        thing: (2,) metres, where the thing is.
        goal: (2,) metres, where it is to be.
        turn: () radians by which it is still to be turned; the agent turns with it.
        fastest: () metres per second.
        pivot: (2,) metres, where the agent turns by more than `ASKEW`; see `turning_place`.
    """
    agents = env.base.agents
    here = state.data.qpos[agents.qpos_ids[agent]]
    # Where the agent stands in the end: the thing keeps its place at the agent's side.
    final = goal - turned(thing - here[:2], turn)
    turns = jnp.abs(turn) > ASKEW
    final = jnp.where(turns, pivot, final)
    turn = jnp.where(turns & (jnp.linalg.norm(pivot - here[:2]) > 0.15), 0.0, turn)
    return drive(state, env, agent, final - here[:2], turn, fastest)


def drive(
    state: State, env: Environment, agent: int, to: jax.Array, turn: jax.Array, fastest: jax.Array | float
) -> jax.Array:
    """Returns forces (3,) of an agent that goes straight, and turns on the way.

    Args:
        state, env, agent: who acts.
        to: (2,) metres that are still to go.
        turn: () radians by which it is still to turn.
        fastest: metres per second.
    """
    velocity = state.data.qvel[env.base.agents.qvel_ids[agent]]
    left = jnp.linalg.norm(to)
    along = to / jnp.maximum(left, 1e-6)
    wanted = along * jnp.minimum(RATE * left, fastest)
    push = DRAG * wanted + PUSH * (wanted - velocity[:2]) + FRICTION * along * (left > STILL)
    spin = jnp.clip(TURN_RATE * turn, -TURN_FASTEST, TURN_FASTEST)
    torque = TURN_DRAG * spin + TURN_PUSH * (spin - velocity[3])
    torque += TURN_FRICTION * jnp.sign(turn) * (jnp.abs(turn) > STILL)
    return jnp.clip(jnp.append(push, torque), -1.0, 1.0)


def swing(
    state: State, env: Environment, agent: int, box: Footprints, to: jax.Array, turn: jax.Array, fastest: float
) -> jax.Array:
    """Returns forces (3,) of an agent with a box in hand, whose middle goes straight while both turn around it.

    Args:
        state, env, agent: who acts.
        box: what is held; one, without an axis of boxes.
        to: (2,) metres that are still to go.
        turn: () radians by which it is still to turn.
        fastest: metres per second.
    """
    own = env.base.agents
    velocity, arm = state.data.qvel[own.qvel_ids[agent]], box.centre - state.data.qpos[own.qpos_ids[agent, :2]]
    across = jnp.stack([-arm[1], arm[0]])
    left = jnp.linalg.norm(to)
    along = to / jnp.maximum(left, 1e-6)
    spin = jnp.clip(TURN_RATE * turn, -TURN_FASTEST, TURN_FASTEST)
    straight = along * jnp.minimum(RATE * left, fastest)
    wanted = straight - spin * across
    missing = PUSH * (straight - velocity[:2] - velocity[3] * across)
    # What moves the box, and would turn both if nothing kept them from it.
    load = SLIDE * along * (left > STILL) + missing / 2
    push = DRAG * wanted + SLIDE * wanted / jnp.maximum(jnp.linalg.norm(wanted), 0.05) + load + missing / 2
    torque = TURN_DRAG * spin + TURN_PUSH * (spin - velocity[3]) + arm[0] * load[1] - arm[1] * load[0]
    torque += TWIST * jnp.linalg.norm(box.half) * jnp.sign(turn) * (jnp.abs(turn) > LEVEL)
    return jnp.clip(jnp.append(push, torque), -1.0, 1.0)


def turning_place(here: jax.Array, within: jax.Array, things: Footprints, radius: jax.Array) -> jax.Array:
    """Returns the nearest place (2,) in metres where an agent can turn with a thing in hand, or the one with most room.

    Args:
        here: (2,) metres.
        within: (4,) x0, y0, x1, y1 of the room in metres.
        things: what is in the way.
        radius: () metres around the agent that it takes to turn.
    """
    low, high = within[:2] + radius, within[2:] - radius
    middle = (low + high) / 2
    low, high = jnp.minimum(low, middle), jnp.maximum(high, middle)
    steps = jnp.linspace(0.0, 1.0, PLACES)
    grid = jnp.stack(jnp.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    places = jnp.concatenate([here[None], low + grid * (high - low)])
    room = jnp.minimum(things.clearance(places), jnp.minimum(places - within[:2], within[2:] - places).min(axis=1))
    cost = jnp.linalg.norm(places - here, axis=1) + SHORT * jnp.maximum(radius - room, 0.0)
    return places[jnp.argmin(cost)]


def footprints(state: State, env: Environment, kinds: tuple[str, ...]) -> Footprints:
    """Returns the footprints of all objects of some kinds; those that are absent are nothing."""
    modules = env.base.objects(kinds)
    at = jnp.concatenate([state.data.qpos[m.qpos_ids[:, :2]] for m in modules])
    yaw = jnp.concatenate([state.data.qpos[m.qpos_ids[:, 3]] for m in modules])
    halves = [
        jnp.where(state.world.active[m.kind][:, None], m.extents_of(state.world)[:, :2] / 2, 0.0) for m in modules
    ]
    return Footprints(at, jnp.concatenate(halves), jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=1))


def without(things: Footprints, out: jax.Array) -> Footprints:
    """Returns footprints without some of them, (n,) bool."""
    return things._replace(half=jnp.where(out[:, None], 0.0, things.half))


def is_stuck(state: State, env: Environment, agent: int) -> jax.Array:
    """Whether an agent neither moves nor turns: () bool."""
    velocity = state.data.qvel[env.base.agents.qvel_ids[agent]]
    return jnp.linalg.norm(velocity[:2]) + jnp.abs(velocity[3]) < 0.15


def joined(*parts: Footprints) -> Footprints:
    """Returns footprints as one."""
    return Footprints(*(jnp.concatenate(x) for x in zip(*parts, strict=True)))


def in_hand(things: Footprints, plan: RoomPlan, off: jax.Array, grow: float) -> Footprints:
    """Returns what is in the way of a thing in hand, as if it were in the way of an agent in the thing's place.

    Args:
        things: what is in the way of both.
        plan: of the rooms, whose walls are in the way of the agent; those in the way of the thing are not returned.
        off: (2,) metres from the thing to its agent, which keeps its heading.
        grow: metres by which the thing is larger than an agent.
    """
    walls = walls_of(plan)
    wider = things._replace(half=jnp.where(things.half > 0, things.half + grow, 0.0))
    beside = joined(things, walls._replace(half=jnp.where(walls.half > 0, walls.half - SLIM, 0.0)))
    return joined(wider, beside._replace(centre=beside.centre - off))
