"""Who takes hold of what (Baker et al.'s published code)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

NOTHING = -1


def grab_rule(candidate: jax.Array, distance: jax.Array, exclusive: bool) -> jax.Array:
    """What every agent holds: the nearest of its candidates.

    Args:
        candidate: (n_agents, n) bool: what an agent wants to hold and can reach.
        distance: (n_agents, n) metres.
        exclusive: whether an object is held by one agent alone. The nearest pair of all goes first, then the nearest
            of those that are left, and so on; the first agent and the first object go first among equals.

    Returns:
        (n_agents,) int32, -1 for nothing.
    """
    n_agents, n_objects = distance.shape
    away = jnp.where(candidate, distance, jnp.inf)
    if not exclusive:
        nearest = away.argmin(axis=1).astype(jnp.int32)
        return jnp.where(candidate.any(axis=1), nearest, NOTHING)
    held = jnp.full(n_agents, NOTHING, jnp.int32)
    for _ in range(min(n_agents, n_objects)):
        pair = away.reshape(-1).argmin()
        agent, thing = pair // n_objects, pair % n_objects
        found = jnp.isfinite(away[agent, thing])
        held = held.at[agent].set(jnp.where(found, thing.astype(jnp.int32), held[agent]))
        taken = (jnp.arange(n_agents)[:, None] == agent) | (jnp.arange(n_objects) == thing)
        away = jnp.where(taken & found, jnp.inf, away)
    return held
