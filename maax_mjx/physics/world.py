"""The overlay: in what one world differs from the compiled model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.layout import RoomPlan

Fields = dict[str, jax.Array]


class World(struct.PyTreeNode):
    """What is particular to one world of a batch. Everything else is shared by the compiled model.

    Attributes:
        fields: MuJoCo model fields in which worlds differ, whole: `geom_pos` (ngeom, 3), `body_gravcomp` (nbody,), ...
        active: by entity kind ("agent", "box", ...), (n_max,) bool: which of the entities are in play.
        plan: the walls and doors.
        valid: () bool; False where the layout could not hold all that was drawn. What found no place is not in play.
    """

    fields: Fields
    active: dict[str, jax.Array]
    plan: RoomPlan
    valid: jax.Array


def model_fields(model: Any, names: tuple[str, ...]) -> Fields:
    """The compiled model's own values of the named fields, as NumPy arrays in float32."""
    return {name: np.asarray(getattr(model, name), np.float32) for name in names}  # type: ignore[misc]


BOX_FIELDS = ("geom_pos", "geom_size", "geom_rbound", "geom_aabb")


def set_boxes(fields: Mapping[str, jax.Array], ids: np.ndarray, pos: jax.Array, half: jax.Array) -> Fields:
    """Moves and resizes box geoms, with the bounds that broad phases read.

    Args:
        fields: must hold `BOX_FIELDS`.
        ids: (n,) geom ids.
        pos: (n, 3) centres in metres.
        half: (n, 3) half extents in metres.
    """
    aabb = jnp.concatenate([jnp.zeros_like(half), half], axis=1)
    return dict(fields) | {
        "geom_pos": jnp.asarray(fields["geom_pos"]).at[ids].set(pos),
        "geom_size": jnp.asarray(fields["geom_size"]).at[ids].set(half),
        "geom_rbound": jnp.asarray(fields["geom_rbound"]).at[ids].set(jnp.linalg.norm(half, axis=1)),
        "geom_aabb": jnp.asarray(fields["geom_aabb"]).at[ids].set(aabb),
    }
