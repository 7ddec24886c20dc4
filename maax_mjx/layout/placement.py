"""Placement functions: where an object may go, as weights over the grid (thesis 4.3.3).

A placement function maps `(layout, cells)` to (G, G) weights for the cell of the object's lower-left corner; `cells`
(2,) is its footprint. Whether the cells are free is checked by the caller. A function that needs a quadrant says so
with `@requires_quadrant`, so that a missing one is an error when the environment is composed.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from maax_mjx.layout.grid import apart, within
from maax_mjx.layout.layout import Layout, PlacementFn


def requires_quadrant(fn: PlacementFn) -> PlacementFn:
    """Marks a placement function that reads `layout.plan.quadrant`."""
    fn.requires_quadrant = True  # type: ignore[attr-defined]
    return fn


def uniform_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Anywhere on the floor."""
    return jnp.ones((layout.grid.size, layout.grid.size))


@requires_quadrant
def quad_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Inside the quadrant."""
    return within(layout.grid.size, cells, layout.plan.quadrant).astype(jnp.float32)


@requires_quadrant
def outside_quad_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Outside the quadrant, uniformly by area (OpenAI picks one of three rectangles around it instead)."""
    return apart(layout.grid.size, cells, layout.plan.quadrant).astype(jnp.float32)
