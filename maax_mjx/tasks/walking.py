"""Scripted agents that find their way through rooms."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.wrappers.enclosure import Footprints, walls_of
from maax_mjx.wrappers.lock_tasks import LockTask
from maax_mjx.wrappers.wrapper import W, find

CELLS = 60
"""Cells along an edge of the floor in which ways are looked for."""
ROOM = 0.19
"""Metres that an agent's middle keeps from walls: its radius, and a little."""
NEAR = 4
"""Cells around a goal from which an agent goes straight to it."""
AT_ONCE = 8
"""Cells by which known ways grow before it is asked whether any still do."""
AHEAD = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if i or j])
"""Cells around an agent's own, of which it goes to the nearest to its goal."""
PUSH, SLOWER = 0.6, 2.5
"""Share of full force on the way, and for each metre near the goal: agents soon go as fast as they are pushed."""
TURN = 1.0
"""Torque for a radian that is missing."""


def ways(plan: RoomPlan, goal: jax.Array, things: Footprints | None = None, room: float = ROOM) -> jax.Array:
    """Returns how far it is from the middle of every cell to a goal, around walls: (CELLS, CELLS) metres.

    Args:
        plan: of the rooms.
        goal: (2,) metres. It counts as reached from the cells around it; infinite where it cannot be reached.
        things: what else is in the way.
        room: metres to be kept from all of it.
    """
    cell = plan.floor_size / CELLS
    middles = (jnp.arange(CELLS) + 0.5) * cell
    points = jnp.stack(jnp.meshgrid(middles, middles, indexing="ij"), axis=-1)
    clearance = walls_of(plan).clearance(points)
    if things is not None:
        clearance = jnp.minimum(clearance, things.clearance(points))
    free = clearance >= room
    away = jnp.linalg.norm(points - goal, axis=-1)
    start = jnp.where(free & (away < NEAR * cell), away, jnp.inf)

    def relaxed(_: int, far: jax.Array) -> jax.Array:
        padded = jnp.pad(far, 1, constant_values=jnp.inf)
        beside = jnp.minimum(padded[:-2], padded[2:])
        straight = jnp.minimum(beside[:, 1:-1], jnp.minimum(padded[1:-1, :-2], padded[1:-1, 2:]))
        across = jnp.minimum(beside[:, :-2], beside[:, 2:])
        found = jnp.minimum(straight + cell, across + np.sqrt(2.0) * cell)
        return jnp.where(free, jnp.minimum(far, found), jnp.inf)

    def relax(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        far, _ = carry
        after = jax.lax.fori_loop(0, AT_ONCE, relaxed, far)
        return after, (after < far).any()

    return jax.lax.while_loop(lambda carry: carry[1], relax, (start, jnp.ones((), bool)))[0]


def next_step(
    plan: RoomPlan, here: jax.Array, goal: jax.Array, things: Footprints | None = None, room: float = ROOM
) -> tuple[jax.Array, jax.Array]:
    """Returns the way (2,) in metres to the next point on the way to a goal, and () bool, whether that is the goal.

    Args:
        plan, goal, things, room: as for `ways`; where there is no way, it goes straight.
        here: (2,) metres.
    """
    cell = plan.floor_size / CELLS
    at, far = _nearest(ways(plan, goal, things, room), (here / cell).astype(jnp.int32), cell)
    straight = (jnp.linalg.norm(goal - here) < NEAR * cell) | ~jnp.isfinite(far)
    return jnp.where(straight, goal, (at + 0.5) * cell) - here, straight


def _nearest(far: jax.Array, at: jax.Array, cell: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the cell (2,) around another from which it is nearest to where ways lead, and () metres through it."""
    beside = jnp.clip(at + AHEAD, 0, CELLS - 1)
    through = far[beside[:, 0], beside[:, 1]] + np.linalg.norm(AHEAD, axis=1) * cell
    return beside[jnp.argmin(through)], through.min()


def step_along(far: jax.Array, floor: jax.Array, here: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the same as `next_step`, for any of many goals.

    Args:
        far: (CELLS, CELLS) metres from `here`, see `ways`.
        floor: () metres, its edge.
        here: (2,) metres.
        goal: (2,) metres.
    """
    cell = floor / CELLS

    def back(at: jax.Array) -> jax.Array:
        return _nearest(far, at, cell)[0]

    def is_on_way(at: jax.Array) -> jax.Array:
        away = far[at[0], at[1]]
        return jnp.isfinite(away) & (away > NEAR * cell)

    end = jnp.clip((goal / cell).astype(jnp.int32), 0, CELLS - 1)
    # What has no room for an agent may be beside what has.
    first = jnp.where(jnp.isfinite(far[end[0], end[1]]), end, back(end))
    at = jax.lax.while_loop(is_on_way, back, first)
    straight = (jnp.linalg.norm(goal - here) < NEAR * cell) | ~jnp.isfinite(far[at[0], at[1]])
    return jnp.where(straight, goal, (at + 0.5) * cell) - here, straight


def walk(state: State, env: Environment, agent: int, goal: jax.Array, things: Footprints | None = None) -> jax.Array:
    """Returns forces (3,) of an agent that walks to a goal (2,), around walls and things, and looks where it goes."""
    here = state.data.qpos[env.base.agents.qpos_ids[agent, :2]]
    return go(state, env, agent, *next_step(state.world.plan, here, goal, things))


def go(state: State, env: Environment, agent: int, to: jax.Array, near: jax.Array, most: float = PUSH) -> jax.Array:
    """Returns forces (3,) of an agent that walks straight, and looks where it goes.

    Args:
        state, env, agent: who acts.
        to: (2,) metres that are still to go.
        near: () bool, whether it is to arrive there.
        most: share of full force.
    """
    away = jnp.linalg.norm(to)
    push = to / jnp.maximum(away, 1e-6) * jnp.where(near, jnp.minimum(most, SLOWER * away), most)
    return jnp.append(push, jnp.where(away < 0.1, 0.0, face(state, env, agent, to)))


def face(state: State, env: Environment, agent: int, to: jax.Array) -> jax.Array:
    """Returns the torque () of an agent that turns to look in a direction (2,)."""
    off = jnp.arctan2(to[1], to[0]) - env.base.agents.headings(state.data)[agent]
    return jnp.clip(TURN * jnp.arctan2(jnp.sin(off), jnp.cos(off)), -1, 1)


def task_of(env: Environment, kind: type[W], game: str) -> W:
    """Returns the wrapper that pays for a task.

    Args:
        env: the game that is played.
        kind: of the wrapper.
        game: name of the game that has one, and of the script that plays it.

    Raises:
        ValueError: an environment without one.
    """
    task = find(env, kind)
    if task is None:
        raise ValueError(f"{game}: got a game without {kind.__name__}; takes one with it, such as the game {game!r}")
    return task


def lock_and_return(state: State, env: Environment, agent: int = 0) -> tuple[jax.Array, dict[str, Any]]:
    """Returns the actions of an agent that locks what `LockTask` has next, and goes back where it began.

    Returns:
        Forces (3,); and "lock", () {0, 1}.

    Raises:
        ValueError: an environment without `LockTask`.
    """
    task = task_of(env, LockTask, "lock_and_return")
    progress = state.mechanics[task.name]
    objects = state.data.qpos[task.module.qpos_ids[:, :2]]
    goal = jnp.where(progress.target >= 0, objects[progress.target], progress.spawn)
    return walk(state, env, agent, goal), {"lock": jnp.ones((), jnp.int32)}
