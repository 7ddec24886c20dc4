"""The placement grid: which cells are taken, kept as an integral image.

`integral[i, j]` counts the marks in cells x < i, y < j. Marking a rectangle adds an outer product of two ramps, and
how many marks any rectangle holds is four reads, so that a free place is found for every corner cell at once.
"""

from __future__ import annotations

from math import ceil

import jax
import jax.numpy as jnp
from flax import struct

CELL_EPS = 1e-4
"""Share of a cell that an extent may reach into the next one, by rounding."""

JAMMING = 0.56
"""Share of an area that equal squares, placed at random one after the other, fill before none fits (Feder 1980)."""


class Grid(struct.PyTreeNode):
    """A square occupancy grid over the floor.

    Attributes:
        integral: (G + 1, G + 1) int32, the integral image of the marks.
        cell: () edge length of a cell in metres.
    """

    integral: jax.Array
    cell: jax.Array

    @classmethod
    def create(cls, grid_size: int, floor_size: jax.Array | float) -> Grid:
        """An empty grid of `grid_size` x `grid_size` cells over a floor of `floor_size` metres."""
        side = grid_size + 1
        return cls(integral=jnp.zeros((side, side), jnp.int32), cell=jnp.asarray(floor_size, float) / grid_size)

    @property
    def size(self) -> int:
        """Cells per side, G."""
        return self.integral.shape[-1] - 1

    def footprint(self, extent: jax.Array) -> jax.Array:
        """How many cells an object of `extent` (2,) metres takes per axis: (2,) int32."""
        return jnp.ceil(extent / self.cell - CELL_EPS).astype(jnp.int32)

    def mark(self, corner: jax.Array, cells: jax.Array, on: jax.Array | bool = True) -> Grid:
        """Marks the rectangle of `cells` (2,) cells whose lower-left cell is `corner` (2,), where `on`."""
        return self.mark_all(corner[None], cells[None], jnp.asarray(on)[None])

    def mark_all(self, corners: jax.Array, cells: jax.Array, on: jax.Array) -> Grid:
        """Marks `n` rectangles: corners and cells (n, 2), where `on` (n,)."""
        edge = jnp.arange(self.size + 1)
        ramp = jnp.clip(edge[:, None, None] - corners, 0, cells) * on[:, None]
        return self.replace(integral=self.integral + ramp[..., 0] @ ramp[..., 1].T)

    def marks(self, cells: jax.Array) -> jax.Array:
        """(G, G) int32: how many marks the rectangle of `cells` (2,) at every corner cell holds.

        Where the rectangle leaves the grid, only its part inside is counted; see `inside`.
        """
        # Two gathers, which fuse with what reads them; slices at traced places do not.
        g = self.size
        x, y = (jnp.minimum(jnp.arange(g) + n, g) for n in (cells[0], cells[1]))
        columns = self.integral[x] - self.integral[:g]
        return columns[:, y] - columns[:, :g]

    def inside(self, cells: jax.Array) -> jax.Array:
        """(G, G) bool: at which corner cells a rectangle of `cells` (2,) stays on the grid."""
        fits = jnp.arange(self.size)[:, None] + cells <= self.size
        return fits[:, None, 0] & fits[None, :, 1]

    def free(self, cells: jax.Array) -> jax.Array:
        """(G, G) bool: at which corner cells a rectangle of `cells` (2,) is on the grid and unmarked."""
        return (self.marks(cells) == 0) & self.inside(cells)

    def occupancy(self) -> jax.Array:
        """(G, G) int32: the marks of every cell."""
        return jnp.diff(jnp.diff(self.integral, axis=0), axis=1)


def footprint_of(extent: tuple[float, float], cell: float) -> tuple[int, int]:
    """How many cells of `cell` metres an object of `extent` (x, y) metres takes per axis, on the host."""
    return ceil(extent[0] / cell - CELL_EPS), ceil(extent[1] / cell - CELL_EPS)


def within(grid_size: int, cells: jax.Array, rect: jax.Array) -> jax.Array:
    """(G, G) bool: corner cells whose rectangle of `cells` (2,) lies in the cell rectangle `rect` (x0, y0, x1, y1)."""
    i = jnp.arange(grid_size)[:, None]
    ok = (i >= rect[:2]) & (i + cells <= rect[2:])
    return ok[:, None, 0] & ok[None, :, 1]


def apart(grid_size: int, cells: jax.Array, rect: jax.Array) -> jax.Array:
    """(G, G) bool: corner cells whose rectangle of `cells` (2,) shares no cell with `rect` (x0, y0, x1, y1)."""
    i = jnp.arange(grid_size)[:, None]
    meets = (i < rect[2:]) & (i + cells > rect[:2])
    return ~(meets[:, None, 0] & meets[None, :, 1])
