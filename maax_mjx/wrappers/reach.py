"""How far agents are from objects."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from maax_mjx.base import Base
from maax_mjx.modules import Entities
from maax_mjx.state import State


def distance_to_objects(base: Base, modules: Sequence[Entities], state: State) -> jax.Array:
    """(n_agents, n) metres from agents' centres to the surfaces of objects, as oriented boxes; 0 inside.

    Ramps and cylinders are taken as their boxes, as OpenAI takes them.
    """
    agents = state.data.xpos[base.agents.body_ids]
    centres = jnp.concatenate([state.data.xpos[m.body_ids] for m in modules])
    quats = jnp.concatenate([state.data.xquat[m.body_ids] for m in modules])
    half = jnp.concatenate([m.extents_of(state.world) for m in modules]) / 2
    local = _into_frame(quats, agents[:, None] - centres)
    return jnp.linalg.norm(jnp.maximum(jnp.abs(local) - half, 0.0), axis=-1)


def present(modules: Sequence[Entities], state: State) -> jax.Array:
    """(n,) bool: which objects are in play."""
    return jnp.concatenate([state.world.active[m.kind] for m in modules])


def _into_frame(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """Vectors (..., n, 3) of the world in the frames of unit quaternions (n, 4)."""
    w, axis = quat[:, :1], quat[:, 1:]
    across = 2 * jnp.cross(-axis, vector)
    return vector + w * across + jnp.cross(-axis, across)
