"""Grid-line walls and their doors.

A wall runs along one row or column of cells, from the centre of its first cell to the centre of its last, is half a
cell thick, and reaches half its thickness further where it meets another wall, so that corners are closed. A door
takes whole cells; the wall ends half a thickness before the last cell's centre on either side of it, which makes the
opening of a door of d cells (d + 1) cells and one thickness wide. Beside another wall it is half a cell narrower.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.layout.choice import choose
from maax_mjx.layout.grid import Grid

VERTICAL = 0
"""The axis of a wall along y."""
HORIZONTAL = 1
"""The axis of a wall along x."""
Scalar = int | jax.Array


class Walls(struct.PyTreeNode):
    """Walls in cells: along y at column `line` (vertical) or along x at row `line` (horizontal). Leaves are (n,).

    Attributes:
        axis: int32, VERTICAL or HORIZONTAL.
        line: int32, the column or row.
        start: int32, first cell along the wall.
        end: int32, last cell along it, included.
        present: bool; what is absent is masked everywhere.
        door_start: int32, first cell of the door.
        door_cells: int32, cells of the door; 0 for none.
        low: int32, where the stretch between junctions that the door lies in begins.
        high: int32, where it ends.
    """

    axis: jax.Array
    line: jax.Array
    start: jax.Array
    end: jax.Array
    present: jax.Array
    door_start: jax.Array
    door_cells: jax.Array
    low: jax.Array
    high: jax.Array

    @classmethod
    def create(
        cls,
        axis: Sequence[Scalar],
        line: Sequence[Scalar],
        start: Sequence[Scalar],
        end: Sequence[Scalar],
    ) -> Walls:
        """Walls without doors, all present.

        Args:
            axis: VERTICAL or HORIZONTAL, of every wall.
            line: the column or row of each.
            start: the first cell along each.
            end: the last cell along each, included.

        Raises:
            ValueError: lists of different lengths.
        """
        if len({len(axis), len(line), len(start), len(end)}) > 1:
            got = f"{len(axis)} axes, {len(line)} lines, {len(start)} starts and {len(end)} ends"
            raise ValueError(f"walls: got {got}; takes one of each for every wall")

        def whole(values: Sequence[Scalar]) -> jax.Array:
            return jnp.array([jnp.asarray(x, jnp.int32) for x in values], jnp.int32)

        first, last, none = whole(start), whole(end), jnp.zeros(len(line), jnp.int32)
        return cls(whole(axis), whole(line), first, last, jnp.ones(len(line), bool), none, none, first, last)

    @property
    def n(self) -> int:
        """How many, absent ones included."""
        return self.line.shape[0]

    def padded(self, n: int) -> Walls:
        """The walls with absent ones added, `n` in all."""
        return jax.tree.map(lambda x: jnp.pad(x, (0, n - self.n)), self)


def join(*walls: Walls) -> Walls:
    """All of several walls."""
    return jax.tree.map(lambda *x: jnp.concatenate(x), *walls)


def thickness(cell: jax.Array) -> jax.Array:
    """Full thickness of a wall in metres."""
    return cell / 2


def cut_doors(key: jax.Array, walls: Walls, door_cells: jax.Array | int, wanted: jax.Array) -> tuple[Walls, jax.Array]:
    """Draws a door for every wall that wants one (OpenAI's rule).

    Junctions with other walls cut a wall into stretches. A stretch of at least a cell more than the door can hold it;
    one of these is drawn uniformly, and in it the place, at least a cell remaining on both sides. So no wall ends in a
    door.

    Args:
        key: a key.
        walls: without doors.
        door_cells: the doors' size in cells; 0 draws none.
        wanted: (n,) bool.

    Returns:
        The walls, and () bool: whether every door that was wanted found a place.
    """
    pick_key, place_key = jax.random.split(key)
    across = walls.axis[:, None] != walls.axis[None, :]
    meets = (walls.start[None, :] <= walls.line[:, None]) & (walls.end[None, :] >= walls.line[:, None])
    on = (walls.line[None, :] > walls.start[:, None]) & (walls.line[None, :] < walls.end[:, None])
    junction = across & meets & on & walls.present[None, :]
    points = jnp.where(junction, walls.line[None, :], walls.start[:, None])
    points = jnp.sort(jnp.concatenate([points, walls.start[:, None], walls.end[:, None]], axis=1), axis=1)
    low, high = points[:, :-1], points[:, 1:]
    usable = high - low >= door_cells + 1
    row, drawn = jnp.arange(walls.n), choose(jax.random.uniform(pick_key, (walls.n,)), usable)
    low, high = low[row, drawn], high[row, drawn]
    steps = jnp.maximum(high - low - door_cells, 1)
    place = low + 1 + jnp.floor(jax.random.uniform(place_key, (walls.n,)) * steps).astype(jnp.int32)
    wanted = wanted & walls.present & (jnp.asarray(door_cells) > 0)
    has = wanted & usable.any(axis=1)
    walls = walls.replace(
        door_start=jnp.where(has, place, 0),
        door_cells=jnp.where(has, door_cells, 0).astype(jnp.int32),
        low=jnp.where(has, low, walls.start),
        high=jnp.where(has, high, walls.end),
    )
    return walls, (has == wanted).all()


def _opening_ends(walls: Walls, cell: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where along the walls their true openings begin and end, in metres; of use only with a door."""
    half = thickness(cell) / 2
    # A door in the first or last place leaves no wall cell beside it but the one that the next wall shares, of which a
    # post one thickness wide stays: that wall may end in a door there, too.
    low = jnp.maximum((walls.door_start - 0.5) * cell - half, (walls.low + 0.5) * cell + half)
    high = jnp.minimum((walls.door_start + walls.door_cells + 0.5) * cell + half, (walls.high + 0.5) * cell - half)
    return low, high


def narrowest_opening(door_cells: int, stretch: int | None) -> float:
    """Cells of the narrowest true opening that doors can have.

    Args:
        door_cells: the doors' size in cells, at least 1.
        stretch: cells of the shortest stretch between two other walls, theirs included; None is any that holds a door.
    """
    fills_stretch = stretch is None or stretch <= door_cells + 2
    return door_cells + (0.5 if fills_stretch else 1.0)


def segments(walls: Walls, cell: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The two pieces of every wall, before and after its door.

    Returns:
        rectangles: (n, 2, 4) x0, y0, x1, y1 in metres.
        present: (n, 2) bool; without a door the first piece is the whole wall.
    """
    half = thickness(cell) / 2
    has_door = walls.door_cells > 0
    low, high = _opening_ends(walls, cell)
    start, end = (walls.start + 0.5) * cell - half, (walls.end + 0.5) * cell + half
    along0, along1 = jnp.stack([start, high], axis=1), jnp.stack([jnp.where(has_door, low, end), end], axis=1)
    across = jnp.broadcast_to(((walls.line + 0.5) * cell)[:, None], along0.shape)
    vertical = jnp.stack([across - half, along0, across + half, along1], axis=-1)
    horizontal = jnp.stack([along0, across - half, along1, across + half], axis=-1)
    rects = jnp.where((walls.axis == VERTICAL)[:, None, None], vertical, horizontal)
    return rects, jnp.stack([walls.present, walls.present & has_door], axis=1)


def openings(walls: Walls, cell: jax.Array) -> jax.Array:
    """(n, 3) x, y of the middle and the width of the true openings in metres; zeros without a door."""
    low, high = _opening_ends(walls, cell)
    along, across = (low + high) / 2, (walls.line + 0.5) * cell
    vertical = (walls.axis == VERTICAL)[:, None]
    middle = jnp.where(vertical, jnp.stack([across, along], axis=1), jnp.stack([along, across], axis=1))
    has_door = walls.present & (walls.door_cells > 0)
    return jnp.where(has_door[:, None], jnp.concatenate([middle, (high - low)[:, None]], axis=1), 0.0)


def mark(grid: Grid, walls: Walls, doorways: bool = True) -> Grid:
    """Marks the walls' cells, where nothing is placed then.

    Args:
        grid: the grid.
        walls: the walls.
        doorways: whether the cells of doorways are marked, too.
    """
    if doorways:
        return _mark_along(grid, walls, walls.start, walls.end, walls.present)
    door_end = walls.door_start + walls.door_cells
    has_door = walls.door_cells > 0
    grid = _mark_along(grid, walls, walls.start, jnp.where(has_door, walls.door_start - 1, walls.end), walls.present)
    return _mark_along(grid, walls, door_end, walls.end, walls.present & has_door)


def _mark_along(grid: Grid, walls: Walls, start: jax.Array, end: jax.Array, on: jax.Array) -> Grid:
    """Marks the cells from `start` to `end` of every wall's line, both included."""
    vertical = (walls.axis == VERTICAL)[:, None]
    length = end - start + 1
    one = jnp.ones_like(length)
    corners = jnp.where(vertical, jnp.stack([walls.line, start], axis=1), jnp.stack([start, walls.line], axis=1))
    cells = jnp.where(vertical, jnp.stack([one, length], axis=1), jnp.stack([length, one], axis=1))
    return grid.mark_all(corners, cells, on)


def outer_walls(grid_size: int, present: jax.Array | bool = True) -> Walls:
    """The four walls around the floor: left, right, bottom, top."""
    last = grid_size - 1
    walls = Walls.create([VERTICAL, VERTICAL, HORIZONTAL, HORIZONTAL], [0, last, 0, last], [0] * 4, [last] * 4)
    return walls.replace(present=jnp.broadcast_to(jnp.asarray(present), (4,)))
