"""Slow, obvious NumPy reference of a random room generator (walls on the lines of a square grid of cells)."""

from collections import defaultdict
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import ndimage

ATTEMPTS_PER_WALL = 10
ROUNDS = 10


class Wall(NamedTuple):
    """A wall on cells start..end (inclusive) of a column (axis 0, vertical) or a row (axis 1, horizontal)."""

    axis: int
    line: int
    start: int
    end: int
    door_start: int = -1  # -1: no door (outer walls, and inner walls before the doors are drawn)


def outer_walls(grid_size: int) -> list[Wall]:
    """Return the four outer walls."""
    last = grid_size - 1
    return [Wall(0, 0, 0, last), Wall(0, last, 0, last), Wall(1, 0, 0, last), Wall(1, last, 0, last)]


def junctions(wall: Wall, side: int, walls: list[Wall]) -> list[int]:
    """Return where walls that lie on one side (-1: smaller lines, +1: larger) end on `wall`, and its own two ends."""
    points = {wall.start, wall.end}
    for other in walls:
        touching_end = other.start if side > 0 else other.end
        if other.axis != wall.axis and touching_end == wall.line and wall.start <= other.line <= wall.end:
            points.add(other.line)
    return sorted(points)


def crosses(new: Wall, other: Wall) -> bool:
    """Tell whether `new` crosses or lies on `other`; touching at one of the ends of `new` is neither."""
    if new.axis == other.axis:
        return new.line == other.line and min(new.end, other.end) > max(new.start, other.start)
    return new.start < other.line < new.end and other.start <= new.line <= other.end


def places(wall: Wall) -> range:
    """Return where along a wall another one may begin."""
    return range(wall.start + 1, wall.end)


def between(wall1: Wall, wall2: Wall, place: int, walls: list[Wall], min_room_size: int) -> Wall | None:
    """Return the wall at a place along `wall1` that reaches to `wall2`; None where there is none to be built."""
    if wall2.axis != wall1.axis or wall2.line == wall1.line or not wall2.start <= place <= wall2.end:
        return None
    side = 1 if wall2.line > wall1.line else -1
    if any(abs(place - point) <= min_room_size for point in junctions(wall1, side, walls)):
        return None
    new = Wall(1 - wall1.axis, place, min(wall1.line, wall2.line), max(wall1.line, wall2.line))
    return None if any(crosses(new, other) for other in walls) else new


def attempt(rng: np.random.Generator, walls: list[Wall], min_room_size: int) -> Wall | None:
    """Try once to find a new inner wall, with a place of its own for every other wall; None if none is kept."""
    wall1 = walls[rng.integers(len(walls))]
    proposed = [between(wall1, wall2, rng.choice(places(wall1)), walls, min_room_size) for wall2 in walls]
    kept = [wall for wall in proposed if wall is not None]
    return kept[rng.integers(len(kept))] if kept else None


def attempt_shares(walls: list[Wall], min_room_size: int) -> dict[Wall, float]:
    """Return the probability of every wall that one attempt can build; they sum to that of building any."""
    shares: dict[Wall, float] = defaultdict(float)
    for wall1 in walls:
        n = len(places(wall1))
        built = [[between(wall1, wall2, place, walls, min_room_size) for place in places(wall1)] for wall2 in walls]
        kept = [[wall for wall in row if wall is not None] for row in built]
        for i, row in enumerate(kept):
            # How many of the others are kept as well, each independently of the rest: one of all is then drawn.
            others = np.ones(1)
            for other in kept[:i] + kept[i + 1 :]:
                others = np.convolve(others, [1 - len(other) / n, len(other) / n])
            drawn = (others / np.arange(1, len(others) + 1)).sum()
            for wall in row:
                shares[wall] += drawn / n / len(walls)
    return shares


def layout_shares(n_rooms: int, grid_size: int, min_room_size: int) -> dict[frozenset[Wall], float]:
    """Return the probability of every set of inner walls (without doors) that a round which succeeds can end with."""
    layouts: dict[frozenset[Wall], float] = {frozenset(): 1.0}
    for _ in range(n_rooms - 1):
        larger: dict[frozenset[Wall], float] = defaultdict(float)
        for inner, share in layouts.items():
            new = attempt_shares([*outer_walls(grid_size), *inner], min_room_size)
            any_wall = min(sum(new.values()), 1.0)
            succeeds = 1 - (1 - any_wall) ** ATTEMPTS_PER_WALL
            for wall, part in new.items():
                larger[inner | {wall}] += share * succeeds * part / any_wall
        layouts = larger
    total = sum(layouts.values())
    return {inner: share / total for inner, share in layouts.items()}


def place_door(rng: np.random.Generator, wall: Wall, walls: list[Wall], door_size: int) -> Wall | None:
    """Return the wall with a door in one of its usable stretches; None if it has none."""
    cuts = sorted(set(junctions(wall, -1, walls)) | set(junctions(wall, 1, walls)))
    usable = [(a, b) for a, b in pairwise(cuts) if b - a >= door_size + 1]
    if not usable:
        return None
    a, b = usable[rng.integers(len(usable))]
    return wall._replace(door_start=a + int(rng.integers(1, b - a - door_size + 1)))


def play_round(
    rng: np.random.Generator, n_rooms: int, grid_size: int, min_room_size: int, door_size: int
) -> list[Wall] | str:
    """Play one round from the outer walls only; return the inner walls, or what failed ("wall" or "door")."""
    walls = outer_walls(grid_size)
    while len(walls) < 4 + n_rooms - 1:
        for _ in range(ATTEMPTS_PER_WALL):
            new = attempt(rng, walls, min_room_size)
            if new is not None:
                walls.append(new)
                break
        else:
            return "wall"
    inner = []
    for wall in walls[4:]:
        with_door = place_door(rng, wall, walls, door_size)
        if with_door is None:
            return "door"
        inner.append(with_door)
    return inner


def generate(
    rng: np.random.Generator, n_rooms: int, grid_size: int = 30, min_room_size: int = 6, door_size: int = 2
) -> tuple[list[Wall], ...] | None:
    """Return a 1-tuple of the inner walls in the order they were built; None after 10 failed rounds."""
    for _ in range(ROUNDS):
        inner = play_round(rng, n_rooms, grid_size, min_room_size, door_size)
        if not isinstance(inner, str):
            return (inner,)
    return None


def room_areas(walls: list[Wall], grid_size: int, open_door_size: int = 0) -> list[int]:
    """Return every room's number of free cells (4-neighbour flood fill); open_door_size > 0 frees the door cells."""
    blocked = np.zeros((grid_size, grid_size), dtype=bool)  # [row, column]
    for wall in [*walls, *outer_walls(grid_size)]:
        cells = blocked[:, wall.line] if wall.axis == 0 else blocked[wall.line, :]
        cells[wall.start : wall.end + 1] = True
    for wall in walls:
        cells = blocked[:, wall.line] if wall.axis == 0 else blocked[wall.line, :]
        if open_door_size:
            cells[wall.door_start : wall.door_start + open_door_size] = False
    labels, n_rooms = ndimage.label(~blocked)
    sizes: list[int] = np.bincount(labels.ravel(), minlength=n_rooms + 1)[1:].tolist()
    return sizes
