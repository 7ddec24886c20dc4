"""How the rooms of the thesis's fixed scenarios (4.3.3) are drawn."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from maax_mjx.layout.rooms import Rooms
from maax_mjx.layout.walls import HORIZONTAL, VERTICAL, Walls

SMALLEST, LARGEST = 0.3, 0.6
"""Edges of a quadrant whose size is drawn, as shares of the floor's."""

SPLITS = 0.4, 0.6
"""Where the walls of "tri" lie, as shares of the floor's edge."""


def empty(key: jax.Array, grid_size: int) -> Rooms:
    """One room: outer walls only."""
    last = grid_size - 1
    return Rooms.create(Walls.create([], [], [], []), [(0, 0, last, last)])


def half(key: jax.Array, grid_size: int) -> Rooms:
    """Two rooms: a horizontal wall across the middle."""
    middle, last = grid_size // 2, grid_size - 1
    walls = Walls.create([HORIZONTAL], [middle], [0], [last])
    return Rooms.create(walls, [(0, 0, last, middle), (0, middle, last, last)])


def quad(key: jax.Array, grid_size: int) -> Rooms:
    """A quadrant of half the floor at high x, low y."""
    return _quadrant(jnp.asarray(grid_size // 2), grid_size)


def var_quad(key: jax.Array, grid_size: int) -> Rooms:
    """A quadrant of 0.3 to 0.6 of the floor."""
    share = jax.random.uniform(key, minval=SMALLEST, maxval=LARGEST)
    return _quadrant(jnp.floor(share * grid_size).astype(jnp.int32), grid_size)


def _quadrant(size: jax.Array, grid_size: int) -> Rooms:
    last = grid_size - 1
    left = grid_size - size
    walls = Walls.create([VERTICAL, HORIZONTAL], [left, size], [0, left], [size, last])
    return Rooms.create(walls, [(left, 0, last, size)], quadrant=True)


def tri(key: jax.Array, grid_size: int) -> Rooms:
    """Three rooms: a wall across the floor, vertical or horizontal, and one from it to a random side."""
    key_split, key_turn, key_side = jax.random.split(key, 3)
    share = jax.random.uniform(key_split, (2,), minval=SPLITS[0], maxval=SPLITS[1])
    first, second = jnp.floor(share * grid_size).astype(jnp.int32)
    horizontal, high = jax.random.bernoulli(key_turn), jax.random.bernoulli(key_side)
    last = grid_size - 1
    start, end = jnp.where(high, first, 0), jnp.where(high, last, first)
    axis = jnp.where(horizontal, HORIZONTAL, VERTICAL)
    walls = Walls.create([axis, 1 - axis], [first, second], [0, start], [last, end])
    # As if the first wall were vertical; x and y change places otherwise.
    whole = jnp.where(high, jnp.stack([0, 0, first, last]), jnp.stack([first, 0, last, last]))
    rooms = jnp.stack([whole, jnp.stack([start, 0, end, second]), jnp.stack([start, second, end, last])])
    rooms = jnp.where(horizontal, rooms[:, jnp.array([1, 0, 3, 2])], rooms)
    return Rooms.create(walls, list(rooms.astype(jnp.int32)))
