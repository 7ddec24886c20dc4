"""The thesis's room scenarios (4.3.3) and random rooms, drawn per world (FACTS: OpenAI's walls).

A room is given by the grid lines of its walls: x0, y0, x1, y1, a wall running along each. Its cells are those between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.layout.walls import HORIZONTAL, VERTICAL, Walls, cut_doors, join, outer_walls

ATTEMPTS = 10


class Rooms(struct.PyTreeNode):
    """The inner walls of a world and the rooms between them.

    Attributes:
        walls: the inner walls, without doors until `with_doors`.
        rooms: (n_rooms, 4) int32, lines of every rectangular room.
        room_mask: (n_rooms,) bool.
        quadrant: () bool, whether room 0 is a quadrant.
        valid: () bool, whether all rooms that were wanted found a place.
    """

    walls: Walls
    rooms: jax.Array
    room_mask: jax.Array
    quadrant: jax.Array
    valid: jax.Array

    def padded(self, n_walls: int, n_rooms: int) -> Rooms:
        """The same with absent walls and rooms added."""
        extra = n_rooms - self.rooms.shape[0]
        return self.replace(
            walls=self.walls.padded(n_walls),
            rooms=jnp.pad(self.rooms, ((0, extra), (0, 0))),
            room_mask=jnp.pad(self.room_mask, (0, extra)),
        )


def _rooms(walls: Walls, rooms: list, *, quadrant: bool = False) -> Rooms:
    lines = jnp.stack([jnp.stack([jnp.asarray(x, jnp.int32) for x in room]) for room in rooms])
    yes = jnp.ones((), bool)
    return Rooms(walls, lines, jnp.ones(len(rooms), bool), jnp.asarray(quadrant), yes)


def empty(key: jax.Array, grid_size: int) -> Rooms:
    """One room: outer walls only."""
    last = grid_size - 1
    return _rooms(Walls.create([], [], [], []), [(0, 0, last, last)])


def half(key: jax.Array, grid_size: int) -> Rooms:
    """Two rooms: a horizontal wall across the middle."""
    middle, last = grid_size // 2, grid_size - 1
    walls = Walls.create([HORIZONTAL], [middle], [0], [last])
    return _rooms(walls, [(0, 0, last, middle), (0, middle, last, last)])


def quad(key: jax.Array, grid_size: int) -> Rooms:
    """A quadrant of half the floor at high x, low y."""
    return _quadrant(jnp.asarray(grid_size // 2), grid_size)


def var_quad(key: jax.Array, grid_size: int) -> Rooms:
    """A quadrant of 0.3 to 0.6 of the floor."""
    share = jax.random.uniform(key, minval=0.3, maxval=0.6)
    return _quadrant(jnp.floor(share * grid_size).astype(jnp.int32), grid_size)


def _quadrant(size: jax.Array, grid_size: int) -> Rooms:
    last = grid_size - 1
    left = grid_size - size
    walls = Walls.create([VERTICAL, HORIZONTAL], [left, size], [0, left], [size, last])
    return _rooms(walls, [(left, 0, last, size)], quadrant=True)


def tri(key: jax.Array, grid_size: int) -> Rooms:
    """Three rooms: a wall across the floor, vertical or horizontal, and one from it to a random side."""
    key_split, key_turn, key_side = jax.random.split(key, 3)
    share = jax.random.uniform(key_split, (2,), minval=0.4, maxval=0.6)
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
    return _rooms(walls, list(rooms.astype(jnp.int32)))


def random_rooms(
    key: jax.Array, grid_size: int, n_rooms: jax.Array, max_rooms: int, min_room_size: jax.Array | int
) -> Rooms:
    """`n_rooms` rooms by splitting: one after the other, a wall goes from a wall to the next parallel one.

    OpenAI's rule: a wall is drawn uniformly and a place on it, then a side; the new wall must be more than
    `min_room_size` cells from the corners of the room that it splits. Ten such draws are made for each new wall.
    Rooms stay rectangles, so that the next parallel wall is the far side of the room, and nothing is crossed.

    Args:
        key: a key.
        grid_size: cells per side.
        n_rooms: () int32, how many are wanted.
        max_rooms: how many there can be.
        min_room_size: in cells.
    """
    outer = outer_walls(grid_size)
    walls = outer.padded(4 + max_rooms - 1)
    last = grid_size - 1
    rooms = jnp.zeros((max_rooms, 4), jnp.int32).at[0].set(jnp.array([0, 0, last, last]))

    def split(carry: tuple[Walls, jax.Array, jax.Array], k: jax.Array) -> tuple[tuple, None]:
        walls, rooms, valid = carry
        wanted = k + 1 < n_rooms
        wall_key, place_key, side_key = jax.random.split(jax.random.fold_in(key, k), 3)
        wall = jax.random.randint(wall_key, (ATTEMPTS,), 0, 4 + k)
        axis, line = walls.axis[wall], walls.line[wall]
        start, end = walls.start[wall], walls.end[wall]
        share = jax.random.uniform(place_key, (ATTEMPTS,))
        at = start + 1 + jnp.floor(share * (end - start - 1)).astype(jnp.int32)
        vertical = (axis == VERTICAL)[:, None]
        # Of every room: its sides along the wall's line, and its extent along the wall.
        near, far = _select(vertical, rooms[:, 0], rooms[:, 1]), _select(vertical, rooms[:, 2], rooms[:, 3])
        low, high = _select(vertical, rooms[:, 1], rooms[:, 0]), _select(vertical, rooms[:, 3], rooms[:, 2])
        beside = ((near == line[:, None]) | (far == line[:, None])) & (jnp.arange(max_rooms) <= k)
        roomy = (at[:, None] - low > min_room_size) & (high - at[:, None] > min_room_size)
        side = jnp.where(beside & roomy, jax.random.uniform(side_key, beside.shape), -1.0)
        found = side.max(axis=1) >= 0
        attempt = found.argmax()
        room = side[attempt].argmax()
        ok = wanted & found[attempt]
        at, turned = at[attempt], vertical[attempt, 0]
        new = 4 + k

        def put(array: jax.Array, value: jax.Array) -> jax.Array:
            return array.at[new].set(jnp.where(ok, value, array[new]))

        walls = walls.replace(
            axis=put(walls.axis, jnp.where(turned, HORIZONTAL, VERTICAL)),
            line=put(walls.line, at),
            start=put(walls.start, near[attempt, room]),
            end=put(walls.end, far[attempt, room]),
            present=put(walls.present, jnp.ones((), bool)),
        )
        old = rooms[room]
        # A wall drawn across a vertical one splits the room in y, and the other way round.
        below = old.at[3].set(jnp.where(turned, at, old[3])).at[2].set(jnp.where(turned, old[2], at))
        above = old.at[1].set(jnp.where(turned, at, old[1])).at[0].set(jnp.where(turned, old[0], at))
        split_rooms = rooms.at[room].set(below).at[k + 1].set(above)
        return (walls, jnp.where(ok, split_rooms, rooms), valid & (ok | ~wanted)), None

    carry = (walls, rooms, jnp.ones((), bool))
    (walls, rooms, valid), _ = jax.lax.scan(split, carry, jnp.arange(max_rooms - 1))
    inner = jax.tree.map(lambda x: x[4:], walls)
    mask = (jnp.arange(max_rooms) < n_rooms) & valid
    return Rooms(inner, rooms, mask, jnp.zeros((), bool), valid)


def _select(condition: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.where(condition, a[None], b[None])


class Scenario(NamedTuple):
    """A fixed scenario: how it is drawn, and how many walls and rooms it has."""

    draw: Callable[[jax.Array, int], Rooms]
    n_walls: int
    n_rooms: int


SCENARIOS = {
    "empty": Scenario(empty, 0, 1),
    "half": Scenario(half, 1, 2),
    "quad": Scenario(quad, 2, 1),
    "var_quad": Scenario(var_quad, 2, 1),
    "tri": Scenario(tri, 2, 3),
}
RANDOM = "random"


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
