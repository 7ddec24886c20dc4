"""Who prevails when agents want an object locked and others do not (Baker et al.'s published code)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

LOCK_TYPES = ("any", "all", "any_specific", "team")


def lock_rule(
    lock_type: str, wants: jax.Array, near: jax.Array, locked: jax.Array, last_owner: jax.Array, team: np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """Which objects are to be locked and which unlocked, before what is locked already is taken into account.

    An object may be in both: it is unlocked, and locked anew by another.

    Args:
        lock_type: one of `LOCK_TYPES`.
        wants: (n_agents, n) bool.
        near: (n_agents, n) bool; who is not near does not count.
        locked: (n,) bool.
        last_owner: (n,) int32, who locked it last; 0 where nobody did, as in the published code, whose first team
            alone can therefore object to the first lock.
        team: (n_agents,) of every agent.

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
