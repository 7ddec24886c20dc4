"""What scripted agents do with a thing in hand: they bring it to a place, turned as it is to be."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.enclosure import Footprints

RATE, FASTEST = 5.0, 3.5
"""Metres per second for a metre that is missing, and at most."""
TURN_RATE, TURN_FASTEST = 4.0, 4.0
"""Radians per second for a radian that is missing, and at most."""
DRAG, PUSH, FRICTION = 0.11, 0.2, 0.2
"""Shares of full force for a metre per second, for one that is missing, and against friction."""
TURN_DRAG, TURN_PUSH, TURN_FRICTION = 0.11, 0.03, 0.04
"""Shares of full torque likewise, for radians."""
STILL = 0.01
"""Metres and radians off below which friction is left to hold a thing."""


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
    within: jax.Array,
) -> jax.Array:
    """Returns forces (3,) of an agent that brings what it holds straight to a place.

    Args:
        state, env, agent: who acts.
        thing: (2,) metres, where the thing is.
        goal: (2,) metres, where it is to be.
        turn: () radians by which it is still to be turned; the agent turns with it.
        fastest: () metres per second.
    """
    agents = env.base.agents
    here, velocity = state.data.qpos[agents.qpos_ids[agent]], state.data.qvel[agents.qvel_ids[agent]]
    # Where the agent stands in the end: the thing keeps its place at the agent's side.
    final = goal - turned(thing - here[:2], turn)
    turns = jnp.abs(turn) > 0.3
    clear = jnp.clip(here[:2], within[:2], within[2:])
    final = jnp.where(turns, jnp.clip(final, within[:2], within[2:]), final)
    close = jnp.linalg.norm(clear - here[:2]) > 0.1
    final = jnp.where(turns & close, clear, final)
    turn = jnp.where(turns & close, 0.0, turn)
    to = final - here[:2]
    left = jnp.linalg.norm(to)
    along = to / jnp.maximum(left, 1e-6)
    wanted = along * jnp.minimum(RATE * left, fastest)
    push = DRAG * wanted + PUSH * (wanted - velocity[:2]) + FRICTION * along * (left > STILL)
    spin = jnp.clip(TURN_RATE * turn, -TURN_FASTEST, TURN_FASTEST)
    torque = TURN_DRAG * spin + TURN_PUSH * (spin - velocity[3])
    torque += TURN_FRICTION * jnp.sign(turn) * (jnp.abs(turn) > STILL)
    return jnp.clip(jnp.append(push, torque), -1.0, 1.0)


def footprints(state: State, env: Environment, kinds: tuple[str, ...]) -> Footprints:
    """Returns the footprints of all objects of some kinds; those that are absent are nothing."""
    modules = [env.base.modules[kind] for kind in kinds]
    at = jnp.concatenate([state.data.qpos[m.qpos_ids[:, :2]] for m in modules])  # type: ignore[attr-defined]
    yaw = jnp.concatenate([state.data.qpos[m.qpos_ids[:, 3]] for m in modules])  # type: ignore[attr-defined]
    half = [
        jnp.where(state.world.active[m.kind][:, None], m.extents_of(state.world)[:, :2] / 2, 0.0)  # type: ignore[attr-defined]
        for m in modules
    ]
    halves = [jnp.broadcast_to(x, (m.n_max, 2)) for x, m in zip(half, modules, strict=True)]  # type: ignore[attr-defined]
    return Footprints(at, jnp.concatenate(halves), jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=1))
