"""Procedural generation on the device: the grid, placement fields, rooms, walls and doors. jax; never mujoco."""

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
    published_middle_placement,
    published_outside_quad_placement,
    published_proximity_placement,
    published_quad_placement,
    published_room_placement,
    published_rooms_in_turn_placement,
    published_uniform_placement,
    quad_placement,
    requires_quadrant,
    room_placement,
    rooms_in_turn_placement,
    separation_placement,
    uniform_placement,
)
from maax_mjx.layout.placements import placement_by_name, placement_names, register_placement
from maax_mjx.layout.plan import RoomPlan
from maax_mjx.layout.poisson import poisson_disc
from maax_mjx.layout.rooms import Rooms
from maax_mjx.layout.scenarios import register_scenario, scenario_names
from maax_mjx.layout.walls import HORIZONTAL, VERTICAL, Walls
from maax_mjx.layout.world import World

__all__ = [
    "HORIZONTAL",
    "VERTICAL",
    "Grid",
    "Layout",
    "PlacementFn",
    "RoomPlan",
    "Rooms",
    "Walls",
    "World",
    "all_of",
    "any_of",
    "at_placement",
    "centre_placement",
    "middle_placement",
    "outside_quad_placement",
    "placement_by_name",
    "placement_names",
    "poisson_disc",
    "proximity_placement",
    "published_middle_placement",
    "published_outside_quad_placement",
    "published_proximity_placement",
    "published_quad_placement",
    "published_room_placement",
    "published_rooms_in_turn_placement",
    "published_uniform_placement",
    "quad_placement",
    "register_placement",
    "register_scenario",
    "requires_quadrant",
    "room_placement",
    "rooms_in_turn_placement",
    "scenario_names",
    "separation_placement",
    "uniform_placement",
]
