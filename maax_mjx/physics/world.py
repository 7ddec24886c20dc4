"""The overlay: in what one world differs from the compiled model."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from operator import attrgetter

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from maax_mjx.layout import RoomPlan

Fields = dict[str, jax.Array]

Overlay = dict[str, np.ndarray]
"""By model field ("geom_size", "opt.gravity"), the (n,) indices of the rows in which worlds differ."""


class World(struct.PyTreeNode):
    """What is particular to one world of a batch. Everything else is shared by the compiled model.

    Attributes:
        fields: by MuJoCo's name, the rows of model fields in which worlds differ: `geom_pos` (n_walls, 3), ... Which
            rows they are is the environment's `overlay`.
        active: by entity kind ("agent", "box", ...), (n_max,) bool: which of the entities are in play.
        extents: by kind, (n_max, 3) metres along the objects' own axes, of kinds whose sizes worlds differ in.
        sites: by kind ("food", ...), (n_max, 3) the centres of marks that nothing collides with, in metres.
        plan: the walls and doors.
        valid: () bool; False where the layout could not hold all that was drawn. What found no place is not in play.
    """

    fields: Fields
    active: dict[str, jax.Array]
    extents: dict[str, jax.Array]
    sites: dict[str, jax.Array]
    plan: RoomPlan
    valid: jax.Array


def union(overlays: Iterable[Mapping[str, np.ndarray]]) -> Overlay:
    """The rows of several overlays together, in order, each once."""
    rows: dict[str, list[np.ndarray]] = {}
    for overlay in overlays:
        for name, ids in overlay.items():
            if len(ids):
                rows.setdefault(name, []).append(np.asarray(ids, int))
    return {name: np.unique(np.concatenate(ids)) for name, ids in sorted(rows.items())}


def model_fields(model: mujoco.MjModel, overlay: Overlay) -> Fields:
    """The compiled model's own values of the overlaid fields, whole."""
    return {name: jnp.asarray(attrgetter(name)(model), float) for name in overlay}


def overlaid_model(model: mujoco.MjModel, overlay: Overlay, world: World) -> mujoco.MjModel:
    """A copy of a compiled model with one world's rows in it. Host only."""
    model = copy.copy(model)
    for name, ids in overlay.items():
        attrgetter(name)(model)[ids] = np.asarray(world.fields[name])
    return model
