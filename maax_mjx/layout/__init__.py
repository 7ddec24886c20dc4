"""Procedural generation on the device: the grid, placement fields, walls and doors. jax; never mujoco."""

from maax_mjx.layout.grid import Grid
from maax_mjx.layout.layout import Layout, PlacementFn
from maax_mjx.layout.placement import outside_quad_placement, quad_placement, requires_quadrant, uniform_placement
from maax_mjx.layout.plan import RoomPlan

__all__ = [
    "Grid",
    "Layout",
    "PlacementFn",
    "RoomPlan",
    "outside_quad_placement",
    "quad_placement",
    "requires_quadrant",
    "uniform_placement",
]
