"""The rule that decides which agent holds which object (Baker et al.'s published code)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

NOTHING = -1
"""Index for no object."""


def grab_rule(candidate: jax.Array, distance: jax.Array, exclusive: bool) -> jax.Array:
    """Decides what every agent holds: the nearest of its candidates.

    Args:
        candidate: (n_agents, n) bool, objects that an agent wants to hold and can reach.
        distance: (n_agents, n) metres.
        exclusive: whether only one agent can hold an object. Pairs are then chosen by distance among the agents and
            objects that are left; ties go to the first agent and the first object.

    Returns:
        (n_agents,) int32, the index of the object; -1 for nothing.
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
