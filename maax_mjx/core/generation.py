"""Drawing a world's layout: every module in turn, and again where something found no place."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import is_traced
from maax_mjx.common.keys import named_keys
from maax_mjx.common.params import DomainParams, params_in_bounds
from maax_mjx.core.composition import Composition
from maax_mjx.core.hooks import checked_layout
from maax_mjx.layout import Layout
from maax_mjx.layout.redraw import redraw
from maax_mjx.physics import model_fields

LAYOUT_TRIES = 8
"""Draws of a layout at most, per reset."""


def draw_layout(env: Composition, key: jax.Array, params: DomainParams) -> Layout:
    """Draws layouts until one holds everything that was drawn, at most `LAYOUT_TRIES` times."""
    floor_size = env.floor_range.draw(key, params, 1)[0]
    in_bounds = params_in_bounds(params, env.parameters) if is_traced(params) else jnp.ones((), bool)

    def draw(attempt: jax.Array) -> Layout:
        layout = _empty_layout(env, attempt, floor_size)
        # As published: what does not fit is drawn anew with its counts, so that fewer of many are left.
        now = key if env.placement_tries is None else jax.random.fold_in(key, attempt)
        for module, own_key in zip(env.modules.values(), named_keys(now, env.modules), strict=True):
            layout = checked_layout(module, own_key, layout, params, env.model)
        return layout

    layout = redraw(draw, LAYOUT_TRIES, key)
    return layout.replace(valid=layout.valid & in_bounds)


def _empty_layout(env: Composition, attempt: jax.Array, floor_size: jax.Array) -> Layout:
    fields = model_fields(env.model, env.overlay)
    if env.floor_range.varies:
        half = floor_size / 2
        fields["geom_pos"] = fields["geom_pos"].at[env.floor_id, :2].set(half)
        fields["geom_size"] = fields["geom_size"].at[env.floor_id, :2].set(half)
    layout = Layout.empty(env.grid_size, floor_size, tries=env.placement_tries)
    return layout.replace(qpos=jnp.asarray(env.qpos_start, float), fields=fields, attempt=attempt)
