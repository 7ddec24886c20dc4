"""Scripted players of tag and of capture the flag."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.modules import Flags
from maax_mjx.tasks.walking import task_of
from maax_mjx.wrappers import CaptureTheFlag, Tag, TeamMembership

WALL = 0.5
"""Metres from the floor's edges within which those who flee turn away from them."""
SLOWER = 4.0
"""Share of full force for each metre that is left on the way to a goal."""
DOOR, IN_LINE = 0.35, 0.1
"""Metres from a door's middle from which an agent goes through it, and by which it may be beside its middle line."""


def tag(state: State, env: Environment) -> jax.Array:
    """Returns forces (n_agents, 3): who is it runs at the nearest whom it can tag, the others run away from it.

    Raises:
        ValueError: an environment without `Tag`.
    """
    tagged = state.mechanics[task_of(env, Tag, "tag").name]
    agents = env.base.agents
    players = jnp.arange(env.n_agents)
    at = state.data.qpos[agents.qpos_ids[:, :2]]
    away = at - at[tagged.it]
    far = jnp.linalg.norm(away, axis=1)
    prey = state.world.active[agents.kind] & (players != tagged.it)
    prey &= ~((players == tagged.safe) & (tagged.safe_for > 0))
    chosen = jnp.argmin(jnp.where(prey, far, jnp.inf))

    room = jnp.stack([at, state.world.plan.floor_size - at])
    edges = jnp.square(jnp.maximum(WALL / jnp.maximum(room, 0.05) - 1, 0))
    flee = away / jnp.maximum(far, 1e-6)[:, None] + edges[0] - edges[1]
    push = jnp.where((players == tagged.it)[:, None], away[chosen], flee)
    return _forces(push / jnp.maximum(jnp.linalg.norm(push, axis=1, keepdims=True), 1e-6))


def capture_the_flag(state: State, env: Environment) -> jax.Array:
    """Returns forces (n_agents, 3) of teams of which every second one guards its flag and the others fetch the other.

    Those who are out or carry a flag go home. Guards run at the nearest opponent in their half who is not out, and wait
    at their base for the next. From half to half all go through the doors between; within one they go straight, so that
    the scenario "half" suits them.

    Raises:
        ValueError: an environment without `CaptureTheFlag`.
    """
    rules = task_of(env, CaptureTheFlag, "capture_the_flag")
    game, team = state.mechanics[rules.name], rules.inner(TeamMembership).team_index
    agents = env.base.agents
    players = jnp.arange(env.n_agents)
    at = state.data.qpos[agents.qpos_ids[:, :2]]
    base = state.world.sites[Flags.kind][:, :2]
    home, half = base[team], state.world.plan.floor_size / 2
    abroad = (at[:, 1] < half) != (home[:, 1] < half)

    can_be_tagged = state.world.active[agents.kind] & ~game.out & abroad
    prey = can_be_tagged & (team != team[:, None])
    far = jnp.where(prey, jnp.linalg.norm(at[:, None] - at, axis=-1), jnp.inf)
    guarded = jnp.where(prey.any(axis=1, keepdims=True), at[jnp.argmin(far, axis=1)], home)

    rank = jnp.sum((team == team[:, None]) & (players < players[:, None]), axis=1)
    carries = (game.carrier[:, None] == players).any(axis=0)
    fetches = (rank % 2 == 0) & (game.carrier[1 - team] < 0)
    goal = jnp.where(fetches[:, None], base[1 - team], guarded)
    goal = jnp.where((game.out | carries)[:, None], home, goal)
    away = _by_door(state.world.plan, at, goal) - at
    far = jnp.linalg.norm(away, axis=1, keepdims=True)
    return _forces(away / jnp.maximum(far, 1e-6) * jnp.minimum(1.0, SLOWER * far))


def _by_door(plan: RoomPlan, at: jax.Array, goal: jax.Array) -> jax.Array:
    """Returns where to go first on the way to goals, (n_agents, 2): to a door if they are in the other half."""
    if not plan.doors.shape[0]:
        return goal
    half = plan.floor_size / 2
    doors = plan.doors[:, :2]
    between = plan.door_mask & (jnp.abs(doors[:, 1] - half) < DOOR)
    detour = jnp.linalg.norm(doors - at[:, None], axis=-1) + jnp.linalg.norm(doors - goal[:, None], axis=-1)
    door = doors[jnp.argmin(jnp.where(between, detour, jnp.inf), axis=1)]
    across = jnp.where(goal[:, 1] < half, -DOOR, DOOR)
    in_line = jnp.abs(at[:, 0] - door[:, 0]) < IN_LINE
    through = door.at[:, 1].add(jnp.where(in_line, across, -across))
    is_apart = ((at[:, 1] < half) != (goal[:, 1] < half)) & between.any()
    return jnp.where(is_apart[:, None], through, goal)


def _forces(push: jax.Array) -> jax.Array:
    """Returns forces (n_agents, 3) along (n_agents, 2), without a torque."""
    return jnp.concatenate([push, jnp.zeros((len(push), 1))], axis=1)
