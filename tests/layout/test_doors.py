"""Every room can be reached, whatever the settings that are accepted: a flood fill of an agent through the walls."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from scipy import ndimage

import maax_mjx as maax
from maax_mjx.layout import walls as wall_layout
from maax_mjx.layout.random_rooms import random_rooms
from maax_mjx.layout.rooms import with_doors
from maax_mjx.layout.scenarios import scenario_by_name

SCENARIOS = ("half", "quad", "var_quad", "tri", "random")
SETTINGS, WORLDS = 20, 100
RADIUS = 0.15
MAX_ROOMS = 12
FINE = 4
"""Lattice points per cell. All walls begin and end on them, and the middle of every opening is one."""


def accepted(module, grid_size, floor_size):
    try:
        module.check(grid_size, floor_size)
    except ValueError:
        return False
    return True


def smallest_floor(module, grid_size):
    """The least edge in metres, to 0.1 mm, of a floor that the module accepts."""
    low, high = 0.0, 60.0
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (low, middle) if accepted(module, grid_size, middle) else (middle, high)
    return high


def extreme(rng, scenario):
    """Cells per side, cells of doors, rooms and their least size, on the smallest floor that takes them, in metres."""
    while True:
        grid_size, door_size = int(rng.integers(8, 25)), int(rng.integers(1, 8))
        n_rooms, min_room_size = int(rng.integers(2, MAX_ROOMS + 1)), door_size + int(rng.integers(0, 3))
        module = maax.WallScenarios(scenario, door_size, n_rooms=n_rooms, min_room_size=min_room_size)
        if accepted(module, grid_size, 60.0):
            return grid_size, door_size, n_rooms, min_room_size, smallest_floor(module, grid_size)


def draw(scenario):
    """Compiles `(key, settings) -> rectangles (n, 4), which stand (n,), rooms (n, 4), which are there (n,), valid`."""

    def one(key, grid_size, door_size, n_rooms, min_room_size, floor_size):
        draw_key, door_key = jax.random.split(key)
        if scenario == "random":
            rooms = random_rooms(draw_key, grid_size, n_rooms, MAX_ROOMS, min_room_size)
        else:
            rooms = scenario_by_name(scenario).draw_rooms(draw_key, grid_size)
        rooms = with_doors(door_key, rooms, door_size, None, grid_size)
        rects, stand = wall_layout.segments(rooms.walls, floor_size / grid_size)
        return rects.reshape(-1, 4), stand.reshape(-1), rooms.rooms, rooms.room_mask, rooms.valid

    return jax.jit(jax.vmap(one, in_axes=(0, *[None] * 5)))


def reachable(rects, grid_size, cell):
    """(n, n) int: by what number of component an agent's middle can be at every lattice point; 0 where it cannot."""
    inner = 3 * FINE // 4  # the inner faces of the outer walls
    n = FINE * grid_size + 1
    free = np.zeros((n, n), bool)
    free[inner + 1 : n - inner - 1, inner + 1 : n - inner - 1] = True
    for x0, y0, x1, y1 in np.rint(rects / cell * FINE).astype(int):
        free[x0 : x1 + 1, y0 : y1 + 1] = False
    clearance = ndimage.distance_transform_edt(free) * cell / FINE
    return ndimage.label(clearance >= RADIUS)[0]


@pytest.mark.parametrize("door_cells", [1, 2, 5])
@pytest.mark.parametrize("more", [2, 3, 4])
def test_the_narrowest_opening_is_the_one_that_is_checked(door_cells, more):
    """Doors in stretches that hold them in one place, in two and in three."""
    stretch = door_cells + more
    walls = wall_layout.Walls.create([wall_layout.VERTICAL], [3], [0], [stretch - 1])

    @jax.jit
    @jax.vmap
    def width(key):
        cut, valid = wall_layout.cut_doors(key, walls, door_cells, jnp.ones(1, bool))
        return wall_layout.openings(cut, jnp.ones(()))[0, 2], valid

    widths, valid = width(jax.random.split(seeds.key(13), 200))
    assert valid.all()
    assert widths.min() == wall_layout.narrowest_opening(door_cells, stretch)


def test_what_agents_pass_is_accepted_and_what_is_narrower_is_not():
    base = maax.Base(1, floor_size=6.0, grid_size=30, impl="c")
    base.add_module(maax.WallScenarios(("quad", "half", "tri"), door_size=1))
    with pytest.raises(ValueError, match=r"door_size: got 1 cells, an opening of 0.30 m where"):
        maax.Base(1, floor_size=6.0, grid_size=30, impl="c").add_module(maax.RandomWalls(3, door_size=1))
    with pytest.raises(ValueError, match=r"door_size: got 2 cells, an opening of 0.25 m where"):
        maax.Base(1, floor_size=(3.0, 6.0), grid_size=30, impl="c").add_module(maax.RandomWalls(3))
    with pytest.raises(ValueError, match=r"floor_size: got 0.90 m at the least, with a room 0.28 m wide"):
        maax.Base(1, floor_size=0.9, grid_size=8, impl="c").add_module(maax.WallScenarios("half", door_size=2))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_agents_reach_every_room_on_the_smallest_floor_that_is_accepted(scenario):
    """2,000 worlds of each scenario, from 20 settings whose doors are as narrow as they can be."""
    rng, drawn = seeds.rng(11), draw(scenario)
    checked = 0
    for i in range(SETTINGS):
        settings = extreme(rng, scenario)
        grid_size, *_, floor_size = settings
        cell = floor_size / grid_size
        keys = jax.random.split(jax.random.fold_in(seeds.key(12), i), WORLDS)
        rects, stand, rooms, there, valid = jax.device_get(drawn(keys, *map(jnp.asarray, settings)))
        np.testing.assert_allclose(rects[stand] / cell * FINE, np.rint(rects[stand] / cell * FINE), atol=1e-3)
        for world in np.flatnonzero(valid):
            component = reachable(rects[world][stand[world]], grid_size, cell)
            assert component.max() == 1, (settings, world)
            middle = (rooms[world][there[world]].reshape(-1, 2, 2).sum(axis=1) + 1) * FINE // 2
            assert component[*middle.T].all(), (settings, world)
            checked += 1
    assert checked > SETTINGS * WORLDS / 4
