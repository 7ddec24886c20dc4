"""A scripted agent that brings boxes to construction sites."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks.walking import face, next_step, task_of, walk
from maax_mjx.wrappers import BlueprintReward
from maax_mjx.wrappers.enclosure import Footprints

NEAR = 0.09
"""Metres from a site's corners within which those of a box lie: a little less than what counts."""
SWING = 0.36
"""Metres by which corners are off for a radian: half the diagonal, and a little."""
ROOM = 0.4
"""Metres that the middle of a box in hand keeps from other boxes and walls: half its diagonal, and a little."""
BESIDE = 0.44
"""Metres from a box's middle where it stands to take hold."""
LOOKING = 0.7
"""Metres from a box's middle within which it looks at the box, wherever it goes."""
RATE, FASTEST = 3.0, 2.0
"""Metres per second for a metre that is missing, and at most; radians likewise."""
PUSH, FRICTION = 0.3, 0.35
"""Shares of full force for a metre per second that is missing, and against friction."""
TURN, TURN_FRICTION = 0.02, 0.06
"""Shares of full torque likewise."""


def blueprint(state: State, env: Environment, agent: int = 0) -> tuple[jax.Array, dict[str, Any]]:
    """Returns the actions of an agent that carries a box to every construction site, one after the other.

    Returns:
        Forces (3,); and "grab" and "lock", () {0, 1} each.

    Raises:
        ValueError: an environment without `BlueprintReward`.
    """
    task = task_of(env, BlueprintReward, "blueprint")
    boxes, sites = task.boxes, task.sites
    there, wanted = state.world.active[boxes.kind], state.world.active[sites.kind]
    at, yaw = state.data.qpos[boxes.qpos_ids[:, :2]], state.data.qpos[boxes.qpos_ids[:, 3]]
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    held = state.mechanics["grabs"].held[agent]
    in_hand = jnp.arange(boxes.n_max) == held

    off = _to_square(yaw)
    gap = jnp.linalg.norm(state.world.sites[sites.kind][:, None, :2] - at, axis=-1)
    fits = (gap + SWING * jnp.abs(off) < NEAR) & there & wanted[:, None]
    placed, full = fits.any(axis=0), fits.any(axis=1) | ~wanted
    to_box = jnp.linalg.norm(at - here, axis=1)
    chosen = jnp.where(held >= 0, in_hand, there & ~placed)
    cost = jnp.where(~full[:, None] & chosen, gap + to_box, jnp.inf)
    site, box = jnp.unravel_index(jnp.argmin(cost), cost.shape)
    goal = state.world.sites[sites.kind][site, :2]

    others = jnp.arange(boxes.n_max) != box
    half = jnp.where((there & others)[:, None], boxes.extents_of(state.world)[:, :2] / 2, 0.0)
    things = Footprints(at, half, jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=1))

    to, _ = next_step(state.world.plan, at[box], goal, things, ROOM)
    away = jnp.linalg.norm(to)
    towards = to / jnp.maximum(away, 1e-6)
    # The speed of the middle of both, which move as one.
    own = env.base.agents.qvel_ids[agent]
    velocity = (state.data.qvel[own[:2]] + state.data.qvel[boxes.qvel_ids[:, :2]][box]) / 2
    left = jnp.linalg.norm(goal - at[box])
    push = PUSH * (towards * jnp.minimum(RATE * left, FASTEST) - velocity) + FRICTION * towards * (left > NEAR / 4)
    spin = state.data.qvel[own[3]]
    torque = -TURN * (RATE * off[box] + spin) - TURN_FRICTION * jnp.sign(off[box]) * (jnp.abs(off[box]) > NEAR / 2)
    carry = jnp.append(push, torque)

    is_done = full.all()
    carrying = (held >= 0) & ~placed[held]
    nearest = jnp.argmin(jnp.where(there, to_box, jnp.inf))
    grab = ~is_done & jnp.where(held >= 0, carrying, nearest == box)
    beside = at[box] + BESIDE * (here - at[box]) / jnp.maximum(to_box[box], 1e-6)
    approach = walk(state, env, agent, beside, things)
    looking = approach.at[2].set(face(state, env, agent, at[box] - here))
    approach = jnp.where(to_box[box] < LOOKING, looking, approach)
    forces = jnp.where(carrying, carry, approach)
    lock = placed[nearest]
    return jnp.where(is_done, 0.0, forces), {"grab": grab.astype(jnp.int32), "lock": lock.astype(jnp.int32)}


def _to_square(yaw: jax.Array) -> jax.Array:
    """Radians from the nearest quarter turn."""
    quarter = jnp.pi / 2
    return yaw - quarter * jnp.round(yaw / quarter)
