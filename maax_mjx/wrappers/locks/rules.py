"""The rules that decide which objects are locked (Baker et al.'s published code)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

LOCK_TYPES = ("any", "all", "any_specific", "team")
"""Names of the lock types; see `LockObjects`."""


def lock_rule(
    lock_type: str, wants: jax.Array, near: jax.Array, locked: jax.Array, last_owner: jax.Array, team: np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """Decides which objects to lock and which to unlock, whether or not they are locked already.

    An object may be in both: it is unlocked, and then locked by another agent.

    Args:
        lock_type: one of `LOCK_TYPES`.
        wants: (n_agents, n) bool, whether an agent wants an object locked.
        near: (n_agents, n) bool; agents that are not near do not count.
        locked: (n,) bool, whether an object is locked now.
        last_owner: (n,) int32, the agent that locked it last; 0 if nobody did, as in the published code, so that only
            the first team can object to the first lock.
        team: (n_agents,) team of every agent.

    Returns:
        lock, unlock: (n,) bool each.
    """
    asking, refusing = wants & near, ~wants & near
    anybody, objects = asking.any(axis=0), refusing.any(axis=0)
    if lock_type == "any":
        return anybody, objects & ~anybody
    if lock_type == "all":
        return anybody & ~objects, objects
    if lock_type == "any_specific":
        owner = jnp.arange(len(team))[:, None] == last_owner
        return anybody, (refusing & owner).any(axis=0) & locked
    same_team = jnp.asarray(team)[:, None] == jnp.asarray(team)[last_owner]
    objects = (refusing & same_team).any(axis=0)
    return anybody & ~objects, objects
