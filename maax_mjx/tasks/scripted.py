"""Scripted agents: pure functions from a state to one agent's action."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from gymnasium import spaces

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.actions import to_bins

PASSING = 0.35
"""Metres from a door's middle within which an agent counts as being in it."""
BEHIND = 0.43
"""Metres from a box's centre to that of an agent that touches it, with a small margin."""

SoloScript = Callable[[State, Environment], tuple[jax.Array, dict[str, Any]]]
"""`(state, env) -> (forces (3,), other parts of the action by name)` of a game's one agent."""


def to_action(env: Environment, forces: jax.Array, **parts: jax.Array) -> dict[str, jax.Array]:
    """Returns an action in the environment's space.

    Args:
        env: the environment.
        forces: (n_agents, 3) in [-1, 1], along x and y and about z.
        **parts: (n_agents,) {0, 1} by name, applied to all objects of a part that has many; missing parts are 0.
    """
    action: dict[str, Any] = {}
    for name, space in env.action_space.spaces.items():
        shape = space.shape or ()
        if name == "move":
            action[name] = forces
            if isinstance(space, spaces.MultiDiscrete):
                action[name] = to_bins(forces, int(space.nvec.flat[0]))
        else:
            part = jnp.asarray(parts.get(name, jnp.zeros(shape[0])), jnp.int32)
            action[name] = jnp.broadcast_to(part.reshape(-1, *[1] * (len(shape) - 1)), shape)
    return action


def act_alone(script: SoloScript, state: State, env: Environment) -> dict[str, jax.Array]:
    """Returns the action of a game's one agent, which a script plays."""
    forces, parts = script(state, env)
    return to_action(env, forces[None], **{name: part[None] for name, part in parts.items()})


def towards(state: State, env: Environment, agent: int, goal: jax.Array, force: float = 1.0) -> jax.Array:
    """Returns forces (3,) towards a point (2,) in metres, smaller over the last centimetres."""
    here = state.data.xpos[env.base.agents.body_ids[agent], :2]
    away = goal - here
    gap = jnp.linalg.norm(away)
    push = away / jnp.maximum(gap, 1e-6) * jnp.minimum(force, 4 * gap)
    return jnp.append(push, 0.0)


def wander(key: jax.Array, step: jax.Array, hold: int = 20) -> jax.Array:
    """Returns forces (3,) in a random direction that changes every `hold` steps."""
    angle = jax.random.uniform(jax.random.fold_in(key, step // hold), maxval=2 * jnp.pi)
    return jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros(())])


def chase(state: State, env: Environment, agent: int, prey: jax.Array) -> jax.Array:
    """Returns forces (3,) towards the nearest agent of `prey` (n_agents,) bool, through the door between them.

    Handles quadrants with one door: if the two are on different sides of its walls, the agent goes to the door, around
    the corner of the walls if needed, and through.
    """
    position = state.data.xpos[env.base.agents.body_ids, :2]
    here = position[agent]
    away = jnp.linalg.norm(position - here, axis=1)
    goal = position[jnp.where(prey & state.world.active[env.base.agents.kind], away, jnp.inf).argmin()]
    if not state.world.plan.doors.shape[0]:
        return towards(state, env, agent, goal)
    door, inward = quadrant_door(state, env)
    inside, goal_inside = in_quadrant(state, env, here), in_quadrant(state, env, goal)
    apart = (inside != goal_inside) & (state.world.plan.door_mask.any())
    across = door + jnp.where(goal_inside, 1.0, -1.0) * inward * PASSING
    before = door - jnp.where(goal_inside, 1.0, -1.0) * inward * PASSING
    sideways = jnp.abs((here - door) @ jnp.array([-inward[1], inward[0]]))
    through = jnp.where(sideways < 0.1, across, before)
    behind_corner = ~inside & ((here - door) @ inward > -0.2)
    through = jnp.where(behind_corner & ~(sideways < 0.3), _outside_corner(state, env), through)
    return towards(state, env, agent, jnp.where(apart, through, goal))


def close_door(state: State, env: Environment, agent: int, box: int = 0) -> tuple[jax.Array, Mapping[str, jax.Array]]:
    """Returns the actions of an agent in the quadrant that carries a box into the door and locks it there.

    Returns:
        Forces (3,); and "grab" and "lock", () {0, 1} each.
    """
    boxes = env.base.modules["box"]
    ids = env.base.agents.qpos_ids[agent]
    here, yaw = state.data.qpos[ids[:2]], state.data.qpos[ids[3]]
    turning = state.data.qvel[env.base.agents.qvel_ids[agent, 3]]
    thing = state.data.xpos[boxes.body_ids[box], :2]  # type: ignore[attr-defined]
    door, inward = quadrant_door(state, env)
    aside = jnp.array([-inward[1], inward[0]])

    # In the box's frame, whose first axis points away from the door: get behind it, around its corner if needed.
    along, across = (here - thing) @ inward, (here - thing) @ aside
    side = jnp.where(across >= 0, 1.0, -1.0)
    behind = thing + inward * BEHIND
    corner = thing + aside * side * 0.55 + inward * jnp.where(jnp.abs(across) < 0.5, along, BEHIND + 0.1)
    grabbing = ((along > 0.37) & (jnp.abs(across) < 0.06)) | (state.mechanics["grabs"].held[agent] == box)
    walk = towards(state, env, agent, jnp.where((along > 0.4) & (jnp.abs(across) < 0.6), behind, corner), 0.5)

    # With the box in hand: first in line with the door, then into it.
    offset = door - thing
    lined_up = jnp.abs(offset @ aside) < 0.04
    goal = jnp.where(lined_up, offset, offset + inward * 0.7)
    gap = jnp.linalg.norm(goal)
    push = goal / jnp.maximum(gap, 1e-6) * jnp.clip(2 * gap + 0.25, 0.0, 0.6)
    there = lined_up & (jnp.abs(offset @ inward) < 0.04)
    locked = state.mechanics["locks"].locked[box]

    carry = jnp.append(jnp.where(there, 0.0, push), jnp.clip(-3 * yaw - 0.1 * turning, -1.0, 1.0))
    forces = jnp.where(locked, 0.0, jnp.where(grabbing, carry, walk))
    grab = grabbing & ~locked
    return forces, {"grab": grab.astype(jnp.int32), "lock": (locked | (grabbing & there)).astype(jnp.int32)}


def in_quadrant(state: State, env: Environment, point: jax.Array) -> jax.Array:
    """Whether a point (2,) is inside the quadrant's walls: () bool."""
    rect = quadrant_rect(state, env)
    return ((point >= rect[:2]) & (point <= rect[2:])).all()


def quadrant_rect(state: State, env: Environment) -> jax.Array:
    """Returns x0, y0, x1, y1 of the quadrant in metres: (4,)."""
    return state.world.plan.quadrant * (state.world.plan.floor_size / env.base.grid_size)


def _outside_corner(state: State, env: Environment) -> jax.Array:
    """Returns a point (2,) outside the corner of the quadrant's walls, in metres."""
    return quadrant_rect(state, env)[jnp.array([0, 3])] + jnp.array([-0.4, 0.4])


def quadrant_door(state: State, env: Environment) -> tuple[jax.Array, jax.Array]:
    """Returns the middle (2,) of the quadrant's first door in metres, and the direction (2,) from it inwards."""
    plan = state.world.plan
    door = plan.doors[plan.door_mask.argmax(), :2]
    left, _, _, top = quadrant_rect(state, env)
    return door, jnp.where(
        jnp.abs(door[0] - left) < jnp.abs(door[1] - top), jnp.array([1.0, 0.0]), jnp.array([0.0, -1.0])
    )
