"""The inner walls of a world, their doors, and the rooms between them."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.layout.walls import Scalar, Walls, cut_doors, join, outer_walls


class Rooms(struct.PyTreeNode):
    """The inner walls of a world and the rooms between them.

    A room is given by the grid lines of its walls: x0, y0, x1, y1, a wall running along each. Its cells are those
    between.

    Attributes:
        walls: the inner walls, without doors until `with_doors`.
        rooms: (n_rooms, 4) int32, lines of every rectangular room.
        room_mask: (n_rooms,) bool.
        quadrant: () bool, whether room 0 is a quadrant, whose walls are the first two.
        valid: () bool, whether all rooms that were wanted found a place.
    """

    walls: Walls
    rooms: jax.Array
    room_mask: jax.Array
    quadrant: jax.Array
    valid: jax.Array

    @classmethod
    def create(cls, walls: Walls, rooms: Sequence[Sequence[Scalar]], *, quadrant: bool = False) -> Rooms:
        """Rooms that are all there.

        Args:
            walls: the inner walls.
            rooms: x0, y0, x1, y1 of every rectangular room, the lines of its walls.
            quadrant: whether the first room is a quadrant, whose walls are the first two.

        Raises:
            ValueError: no room, or one of another number of lines.
        """
        if not rooms or any(len(room) != 4 for room in rooms):
            raise ValueError(f"rooms: got {rooms!r}; takes x0, y0, x1, y1 of one room or more")
        lines = jnp.array([[jnp.asarray(line, jnp.int32) for line in room] for room in rooms], jnp.int32)
        return cls(walls, lines, jnp.ones(len(rooms), bool), jnp.asarray(quadrant), jnp.ones((), bool))

    def padded(self, n_walls: int, n_rooms: int) -> Rooms:
        """The same with absent walls and rooms added."""
        extra = n_rooms - self.rooms.shape[0]
        return self.replace(
            walls=self.walls.padded(n_walls),
            rooms=jnp.pad(self.rooms, ((0, extra), (0, 0))),
            room_mask=jnp.pad(self.room_mask, (0, extra)),
        )


def with_doors(
    key: jax.Array, rooms: Rooms, door_cells: jax.Array | int, dropout: jax.Array | None, grid_size: int
) -> Rooms:
    """Cuts a door into every wall; of a quadrant's two, one alone keeps its door with probability `dropout`, if any."""
    cut_key, drop_key, which_key = jax.random.split(key, 3)
    wanted = jnp.ones(rooms.walls.n, bool)
    if rooms.walls.n > 1 and dropout is not None:
        drop = rooms.quadrant & jax.random.bernoulli(drop_key, dropout)
        which = jax.random.bernoulli(which_key).astype(jnp.int32)
        wanted = (jnp.arange(rooms.walls.n) != which) | ~drop
    everything = join(rooms.walls, outer_walls(grid_size))
    none = jnp.zeros(4, bool)
    walls, ok = cut_doors(cut_key, everything, door_cells, jnp.concatenate([wanted, none]))
    return rooms.replace(walls=jax.tree.map(lambda x: x[: rooms.walls.n], walls), valid=rooms.valid & ok)
