"""Random rooms by recursive splitting (OpenAI's RandomWalls; thesis 4.3.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from maax_mjx.common.keys import draw_integer
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout.choice import choose
from maax_mjx.layout.grid import JAMMING
from maax_mjx.layout.rooms import Rooms
from maax_mjx.layout.walls import HORIZONTAL, VERTICAL, Walls, outer_walls

ATTEMPTS = 10
"""Draws of a place for each new wall, as OpenAI's."""


@dataclass(frozen=True)
class RandomRooms:
    """The scenario of random rooms.

    Attributes:
        counts: the least and the most rooms.
        min_room_size: in cells; see `random_rooms`.
    """

    counts: tuple[int, int] = (1, 1)
    min_room_size: int = 1
    quadrant_cells = None
    shortest_wall = None
    fixed_doors = False
    fixed_walls = False
    tries = 8

    @property
    def n_walls(self) -> int:
        """One fewer than rooms."""
        return self.counts[1] - 1

    @property
    def n_rooms(self) -> int:
        """The most there can be."""
        return self.counts[1]

    def narrowest_room(self, grid_size: int) -> int:
        """One cell more than walls keep from each other, and both walls."""
        return self.min_room_size + 2

    def wall_cells(self, grid_size: int) -> int:
        """All walls from side to side."""
        return self.n_walls * grid_size

    @property
    def parameters(self) -> list[Parameter]:
        """The number of rooms."""
        return [Parameter("n_rooms", self.counts, (1, self.counts[1]))]

    def sized(self, n_rooms: tuple[int, int], min_room_size: int) -> RandomRooms:
        """The scenario with as many rooms, of such a size."""
        return replace(self, counts=n_rooms, min_room_size=min_room_size)

    def check(self, grid_size: int) -> None:
        """Refuses more rooms than fit.

        Raises:
            ValueError: too many rooms, or too large ones, for the grid.
        """
        g, size = grid_size, self.min_room_size
        most = max(int(JAMMING * (g - 1) ** 2 / (size + 1) ** 2), 2)
        if self.n_rooms > most:
            raise ValueError(
                f"n_rooms: got {self.n_rooms}; takes at most {most} of min_room_size {size} on {g} x {g} cells, of "
                f"which random rooms fill {JAMMING:.0%}"
            )
        if self.n_rooms > 1 and 2 * (size + 1) > g - 1:
            raise ValueError(f"min_room_size: got {size} cells; two such rooms are wider than {g} cells")

    def draw(self, key: jax.Array, count_key: jax.Array, grid_size: int, params: DomainParams) -> Rooms:
        """The rooms of one world."""
        n_rooms = draw_integer(count_key, *params["n_rooms"])
        return random_rooms(key, grid_size, n_rooms, self.n_rooms, self.min_room_size)


def random_rooms(
    key: jax.Array, grid_size: int, n_rooms: jax.Array, max_rooms: int, min_room_size: jax.Array | int
) -> Rooms:
    """Draws `n_rooms` rooms by splitting: one after the other, a wall goes from a wall to the next parallel one.

    OpenAI's rule: a wall is drawn uniformly, and for every other parallel wall a place along it, where a wall from the
    one to the other may be built. It may if both are sides of one room, and it is more than `min_room_size` cells from
    the room's corners. One of those that may be is drawn uniformly. Ten such draws are made for each new wall.
    Rooms stay rectangles, so that such a wall crosses nothing.

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
        wall_key, place_key, other_key = jax.random.split(jax.random.fold_in(key, k), 3)
        wall = jax.random.randint(wall_key, (ATTEMPTS,), 0, 4 + k)
        axis, line, start, end = (x[wall, None] for x in (walls.axis, walls.line, walls.start, walls.end))
        # Of every attempt and every other wall: a place along the attempt's wall. The walls are the first axis of the
        # draw, so that more of them would not change it.
        share = jax.random.uniform(place_key, (walls.n, ATTEMPTS)).T
        at = start + 1 + jnp.floor(share * (end - start - 1)).astype(jnp.int32)
        faces = (walls.axis == axis) & walls.present & (walls.start <= at) & (at <= walls.end)
        vertical = axis == VERTICAL
        # Of every attempt and room: its sides along the wall's line, and its extent along the wall.
        near, far = _select(vertical, rooms[:, 0], rooms[:, 1]), _select(vertical, rooms[:, 2], rooms[:, 3])
        low, high = _select(vertical, rooms[:, 1], rooms[:, 0]), _select(vertical, rooms[:, 3], rooms[:, 2])
        # Of every attempt, other wall and room: whether the room lies between the two and is roomy at the place.
        first, second = line[:, :, None], walls.line[None, :, None]
        lower, upper = jnp.minimum(first, second), jnp.maximum(first, second)
        between = (near[:, None] == lower) & (far[:, None] == upper) & (jnp.arange(max_rooms) <= k)
        roomy = (at[..., None] - low[:, None] > min_room_size) & (high[:, None] - at[..., None] > min_room_size)
        splits = faces[..., None] & between & roomy
        fits = splits.any(axis=2)
        found = fits.any(axis=1)
        attempt = found.argmax()
        other = choose(jax.random.uniform(other_key), fits[attempt])
        room = splits[attempt, other].argmax()
        ok = wanted & found[attempt]
        at, turned = at[attempt, other], vertical[attempt, 0]
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
