"""Detection and containment of physics faults."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.layout import RoomPlan
from maax_mjx.physics.data import Data

MARGIN = 0.2
"""Metres by which an entity's centre may be outside of a closed arena, or below the floor.

An agent that squeezed through the outer wall stood 0.24 m outside for good. 256 episodes of trained agents had the
same number of faults with 0.05, 0.1, 0.2 and 0.3 m.
"""
DIVERGED = 1e10
"""Metres, radians, and these per second, beyond which MuJoCo calls a state bad."""
AGENT_CEILING = 3.0
"""Metres above the floor that an agent's centre may reach."""


def find_fault(
    data: Data, plan: RoomPlan, position: jax.Array, active: jax.Array, is_agent: np.ndarray, may_leave: bool = False
) -> jax.Array:
    """Whether a world's physics went wrong: a number that diverged or is none, or an entity in play that is astray.

    Args:
        data: the state after a step.
        plan: the world's room plan, with its floor size and whether it is closed.
        position: (n, 3) metres, of all entities.
        active: (n,) bool, which entities are in play.
        is_agent: (n,) bool, which entities are agents.
        may_leave: whether entities may be astray, so that only numbers that diverged are a fault.

    Returns:
        () bool, true for a fault.
    """
    # NaN is not smaller either.
    finite = (jnp.abs(data.qpos) < DIVERGED).all() & (jnp.abs(data.qvel) < DIVERGED).all()
    if may_leave:
        return ~finite
    return ~finite | (astray(plan, position, is_agent) & active).any()


def astray(plan: RoomPlan, position: jax.Array, is_agent: np.ndarray) -> jax.Array:
    """Which entities are beyond `MARGIN` outside a closed arena or below the floor, or agents above `AGENT_CEILING`.

    Returns:
        (n,) bool.
    """
    out = ((position[:, :2] < -MARGIN) | (position[:, :2] > plan.floor_size + MARGIN)).any(axis=1)
    out &= plan.closed
    return out | (position[:, 2] < -MARGIN) | (is_agent & (position[:, 2] > AGENT_CEILING))


def contain(fault: jax.Array, before: Data, after: Data) -> Data:
    """Returns `after`, or after a fault the state before the step, at rest. Poses are computed later."""
    return after.replace(
        time=jnp.where(fault, before.time, after.time),
        qpos=jnp.where(fault, before.qpos, after.qpos),
        qvel=jnp.where(fault, 0.0, after.qvel),
        qacc_warmstart=jnp.where(fault, 0.0, after.qacc_warmstart),
    )
