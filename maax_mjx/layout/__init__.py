"""Procedural generation on the device: the grid, placement fields, walls and doors. jax; never mujoco."""

from maax_mjx.layout.grid import Grid
from maax_mjx.layout.layout import Layout, PlacementFn
from maax_mjx.layout.placement import (
    all_of,
    any_of,
    at_placement,
    centre_placement,
    middle_placement,
    outside_quad_placement,
    proximity_placement,
    quad_placement,
    requires_quadrant,
    room_placement,
    separation_placement,
    uniform_placement,
)
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.layout.poisson import poisson_disc
from maax_mjx.layout.world import World

__all__ = [
    "Grid",
    "Layout",
    "PlacementFn",
    "RoomPlan",
    "World",
    "all_of",
    "any_of",
    "at_placement",
    "centre_placement",
    "middle_placement",
    "outside_quad_placement",
    "poisson_disc",
    "proximity_placement",
    "quad_placement",
    "requires_quadrant",
    "room_placement",
    "separation_placement",
    "uniform_placement",
]
