"""How several worlds share a picture: a tile for each, with a strip for its words above it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

TINY = 60
"""Pixels of a tile below which they have none."""
LINE = 1.4
"""Height of a line of words over that of its letters."""
SMALLEST, LARGEST = 9, 20
"""Pixels of letters."""
MOST = 0.3
"""Share of a tile that its words take at most."""
NARROW = 300
"""Pixels of a tile below which agents have short names."""


class Gallery(NamedTuple):
    """The tiles of a picture, row by row from the upper left.

    Attributes:
        size: width and height of the picture in pixels.
        n: number of worlds.
        columns: tiles in a row.
        letters: height of a strip's letters.
        strip: height of a strip; 0 for a single world, whose words stand in its picture.
    """

    size: tuple[int, int]
    n: int
    columns: int
    letters: int
    strip: int

    @property
    def tile(self) -> tuple[int, int]:
        """Width and height of a tile, without its strip."""
        return self.size[0] // self.columns, max(self.size[1] // self.rows - self.strip, 1)

    @property
    def rows(self) -> int:
        """Rows of tiles."""
        return -(-self.n // self.columns)

    @property
    def is_narrow(self) -> bool:
        """Whether there is no room for agents' whole names."""
        return min(self.tile) < NARROW

    @property
    def has_names(self) -> bool:
        """Whether there is room for names at all."""
        return min(self.tile) >= TINY

    def corner(self, i: int) -> tuple[int, int]:
        """Pixels from the upper left to where a world's tile begins, its strip included."""
        row, column = divmod(i, self.columns)
        width, height = self.tile
        return column * width, row * (height + self.strip)

    def fitting(self, lines: list[str]) -> list[str]:
        """The lines for which a strip has room."""
        return lines if self.n == 1 else lines[: int(self.strip / (self.letters * LINE))]


def arrange(n: int, size: tuple[int, int], n_lines: int) -> Gallery:
    """Arranges worlds so that their square floors are large and few places are empty.

    Args:
        n: number of worlds.
        size: width and height of the picture in pixels.
        n_lines: of words above each world.
    """
    found = [_of(n, size, n_lines, columns) for columns in range(1, n + 1)]
    return max(found, key=lambda one: min(one.tile) * (n / (one.columns * one.rows)) ** 0.5)


def _of(n: int, size: tuple[int, int], n_lines: int, columns: int) -> Gallery:
    width, height = size[0] // columns, size[1] // -(-n // columns)
    letters = int(min(max(min(width, height) * 0.055, SMALLEST), LARGEST))
    lines = min(n_lines, int(MOST * height / (letters * LINE))) if n > 1 else 0
    return Gallery(size, n, columns, letters, round(lines * letters * LINE) + (2 if lines else 0))


Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels."""


def lift(box: Box, taken: Sequence[Box]) -> float:
    """Returns by how many pixels a word's box is to go up so that it lies over none of those that are taken."""
    left, top, right, bottom = box
    up = 0.0
    # Each round goes above some of them, and never comes back.
    for _ in taken:
        under = [t for t in taken if t[0] < right and left < t[2] and t[1] < bottom - up and top - up < t[3]]
        if not under:
            break
        up = bottom - min(t[1] for t in under)
    return up


def initials(name: str) -> str:
    """A short name of an agent: "h0" of "hider_0"."""
    word, _, number = name.rpartition("_")
    return f"{word[:1]}{number}" if word else name
