"""What the walls of one world look like, for placement, observations and pictures."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct


class RoomPlan(struct.PyTreeNode):
    """The room plan of one world. Absent walls and doors are masked and zero.

    Attributes:
        walls: (n_walls, 4) x0, y0, x1, y1 of every wall's footprint in metres.
        wall_heights: (n_walls,) metres.
        wall_mask: (n_walls,) bool.
        doors: (n_doors, 3) x, y of the opening's middle and its width, in metres.
        door_mask: (n_doors,) bool.
        quadrant: (4,) int32, the cells inside the quadrant: x0, y0, x1, y1 (exclusive); zeros without one.
        rooms: (n_rooms, 4) int32, likewise the cells inside every rectangular room.
        room_mask: (n_rooms,) bool.
        scenario: () int32, which of the environment's scenarios this is.
        closed: () bool, whether outer walls or limits keep everything on the floor.
        floor_size: () edge of the floor in metres.
    """

    walls: jax.Array
    wall_heights: jax.Array
    wall_mask: jax.Array
    doors: jax.Array
    door_mask: jax.Array
    quadrant: jax.Array
    rooms: jax.Array
    room_mask: jax.Array
    scenario: jax.Array
    closed: jax.Array
    floor_size: jax.Array

    @classmethod
    def empty(cls, floor_size: jax.Array | float) -> RoomPlan:
        """The plan of an open floor of `floor_size` () metres."""
        return cls(
            walls=jnp.zeros((0, 4)),
            wall_heights=jnp.zeros(0),
            wall_mask=jnp.zeros(0, bool),
            doors=jnp.zeros((0, 3)),
            door_mask=jnp.zeros(0, bool),
            quadrant=jnp.zeros(4, jnp.int32),
            rooms=jnp.zeros((0, 4), jnp.int32),
            room_mask=jnp.zeros(0, bool),
            scenario=jnp.zeros((), jnp.int32),
            closed=jnp.zeros((), bool),
            floor_size=jnp.asarray(floor_size, float),
        )
