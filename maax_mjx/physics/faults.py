"""Physics faults: found, contained, counted."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.physics.data import Data

MARGIN = 0.3
AGENT_CEILING = 3.0


def find_fault(
    data: Data, floor_size: float, bodies: np.ndarray, active: jax.Array, agents: np.ndarray, agents_active: jax.Array
) -> jax.Array:
    """Whether a world's physics went wrong.

    A fault is a number that is not finite, an entity whose centre is outside the arena by more than 0.3 m (to the
    sides or below), or an agent above 3 m.

    Args:
        data: the state after a step.
        floor_size: edge of the arena in metres.
        bodies, active: (n,) body ids of all entities, and which are in play.
        agents, agents_active: likewise of the agents alone.

    Returns:
        () bool.
    """
    finite = jnp.isfinite(data.qpos).all() & jnp.isfinite(data.qvel).all()
    pos = data.xpos[bodies]
    out = ((pos[:, :2] < -MARGIN) | (pos[:, :2] > floor_size + MARGIN)).any(axis=1) | (pos[:, 2] < -MARGIN)
    high = data.xpos[agents, 2] > AGENT_CEILING
    return ~finite | (out & active).any() | (high & agents_active).any()


def contain(fault: jax.Array, before: Data, after: Data) -> Data:
    """`after`, or where there was a fault the state before the step, at rest. What the engine carries is kept."""
    held = before.replace(
        qvel=jnp.zeros_like(before.qvel), qacc_warmstart=jnp.zeros_like(before.qacc_warmstart), engine=after.engine
    )
    public = jax.tree.map(lambda a, b: jnp.where(fault, a, b), held.replace(engine=()), after.replace(engine=()))
    return public.replace(engine=after.engine)
