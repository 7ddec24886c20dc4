"""The rows of model fields in which worlds differ from the compiled model."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from operator import attrgetter

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

Fields = dict[str, jax.Array]
"""Values of the rows that an overlay names, by model field."""

Overlay = dict[str, np.ndarray]
"""Indices (n,) of the rows in which worlds differ, by model field ("geom_size", "opt.gravity")."""


def union(overlays: Iterable[Mapping[str, np.ndarray]]) -> Overlay:
    """Unites the rows of several overlays, in order, each once."""
    rows: dict[str, list[np.ndarray]] = {}
    for overlay in overlays:
        for name, ids in overlay.items():
            if len(ids):
                rows.setdefault(name, []).append(np.asarray(ids, int))
    return {name: np.unique(np.concatenate(ids)) for name, ids in sorted(rows.items())}


def model_fields(model: mujoco.MjModel, overlay: Overlay) -> Fields:
    """The compiled model's own values of the overlaid fields, whole."""
    return {name: jnp.asarray(attrgetter(name)(model), float) for name in overlay}


def overlaid_model(model: mujoco.MjModel, overlay: Overlay, fields: Fields) -> mujoco.MjModel:
    """A copy of a compiled model with one world's rows in it. Host only."""
    model = copy.copy(model)
    for name, ids in overlay.items():
        attrgetter(name)(model)[ids] = np.asarray(fields[name])
    return model
