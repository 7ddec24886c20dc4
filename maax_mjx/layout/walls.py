"""Grid-line walls and their doors.

A wall runs along one row or column of cells, from the centre of its first cell to the centre of its last, is half a
cell thick, and reaches half its thickness further where it meets another wall, so that corners are closed. A door
takes whole cells; the wall ends half a thickness before the last cell's centre on either side of it, which makes the
opening of a door of d cells (d + 1) cells and one thickness wide.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.layout.grid import Grid

VERTICAL, HORIZONTAL = 0, 1


class Wall(struct.PyTreeNode):
    """A wall in cells: along y at column `line` (vertical) or along x at row `line` (horizontal).

    Attributes:
        axis: () int32, VERTICAL or HORIZONTAL.
        line: () int32, the column or row.
        start, end: () int32, first and last cell along the wall, both included.
        door_start: () int32, first cell of the door.
        door_cells: () int32, cells of the door; 0 for none.
    """

    axis: jax.Array
    line: jax.Array
    start: jax.Array
    end: jax.Array
    door_start: jax.Array
    door_cells: jax.Array

    @classmethod
    def create(cls, axis: int, line: int, start: int, end: int) -> Wall:
        """A wall without a door."""
        return cls(*(jnp.asarray(v, jnp.int32) for v in (axis, line, start, end, 0, 0)))


def thickness(cell: jax.Array) -> jax.Array:
    """Full thickness of a wall in metres."""
    return cell / 2


def cut_door(key: jax.Array, wall: Wall, door_cells: int) -> Wall:
    """Draws a door's place uniformly, at least one cell of wall remaining on both sides (OpenAI's rule)."""
    length = wall.end - wall.start
    start = wall.start + jax.random.randint(key, (), 1, length - door_cells + 1)
    return wall.replace(door_start=start, door_cells=jnp.asarray(door_cells, jnp.int32))


def _opening_ends(wall: Wall, cell: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where along the wall its true opening begins and ends, in metres; of use only with a door."""
    half = thickness(cell) / 2
    # A door in the first or last place leaves no wall cell beside it but the one that the next wall shares, of which a
    # post one thickness wide stays: that wall may end in a door there, too.
    low = jnp.maximum((wall.door_start - 0.5) * cell - half, (wall.start + 0.5) * cell + half)
    high = jnp.minimum((wall.door_start + wall.door_cells + 0.5) * cell + half, (wall.end + 0.5) * cell - half)
    return low, high


def segments(wall: Wall, cell: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The wall's two pieces, before and after its door.

    Returns:
        rectangles: (2, 4) x0, y0, x1, y1 in metres.
        present: (2,) bool; without a door the first piece is the whole wall.
    """
    half = thickness(cell) / 2
    has_door = wall.door_cells > 0
    low, high = _opening_ends(wall, cell)
    start, end = (wall.start + 0.5) * cell - half, (wall.end + 0.5) * cell + half
    along0, along1 = jnp.stack([start, high]), jnp.stack([jnp.where(has_door, low, end), end])
    across = (wall.line + 0.5) * cell
    across0, across1 = jnp.full(2, across - half), jnp.full(2, across + half)
    vertical = jnp.stack([across0, along0, across1, along1], axis=1)
    horizontal = jnp.stack([along0, across0, along1, across1], axis=1)
    return jnp.where(wall.axis == VERTICAL, vertical, horizontal), jnp.stack([jnp.ones((), bool), has_door])


def opening(wall: Wall, cell: jax.Array) -> jax.Array:
    """(3,) x, y of the middle and the width of the true opening in metres; zeros without a door."""
    low, high = _opening_ends(wall, cell)
    along, across = (low + high) / 2, (wall.line + 0.5) * cell
    middle = jnp.where(wall.axis == VERTICAL, jnp.stack([across, along]), jnp.stack([along, across]))
    return jnp.where(wall.door_cells > 0, jnp.append(middle, high - low), 0.0)


def mark_wall(grid: Grid, wall: Wall) -> Grid:
    """Marks the wall's cells, its doorway included: nothing is placed in a doorway."""
    corner = jnp.where(wall.axis == VERTICAL, jnp.stack([wall.line, wall.start]), jnp.stack([wall.start, wall.line]))
    length = wall.end - wall.start + 1
    one = jnp.ones_like(length)
    cells = jnp.where(wall.axis == VERTICAL, jnp.stack([one, length]), jnp.stack([length, one]))
    return grid.mark(corner, cells)


def outer_walls(grid_size: int) -> list[Wall]:
    """The four walls around the floor: left, right, bottom, top."""
    last = grid_size - 1
    return [
        Wall.create(VERTICAL, 0, 0, last),
        Wall.create(VERTICAL, last, 0, last),
        Wall.create(HORIZONTAL, 0, 0, last),
        Wall.create(HORIZONTAL, last, 0, last),
    ]


def quadrant_walls(grid_size: int, quadrant: int) -> list[Wall]:
    """The two walls of the quadrant at high x, low y: the vertical one, then the horizontal one."""
    last = grid_size - 1
    return [
        Wall.create(VERTICAL, grid_size - quadrant, 0, quadrant),
        Wall.create(HORIZONTAL, quadrant, grid_size - quadrant, last),
    ]


def quadrant_cells(grid_size: int, quadrant: int) -> jax.Array:
    """(4,) int32: the cells inside those walls, x0, y0, x1, y1 (exclusive)."""
    return jnp.array([grid_size - quadrant + 1, 1, grid_size - 1, quadrant], jnp.int32)
