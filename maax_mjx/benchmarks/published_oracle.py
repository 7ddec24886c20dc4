"""Slow, obvious NumPy reference of how the two published games begin: places are tried, and worlds drawn anew.

The floor is a square of 30 by 30 cells of 0.2 m. What a thing covers is blocked, as are walls; doorways and the border
of an arena without outer walls are free. A thing is tried in at most ten places; if none is free, nothing is kept of
the world, not even how many rooms and boxes it was to have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maax_mjx.benchmarks import rooms_oracle as rooms
from maax_mjx.benchmarks.rooms_oracle import Wall

G, CELL, TRIES, DOOR, NEAR = 30, 0.2, 10, 2, 3
QUADRANT, FULL = "hide_and_seek_quadrant", "hide_and_seek_full"
AGENT, CUBE, RAMP = (0.3, 0.3), (0.5, 0.5), (0.5, 0.5)
LONG = (1.65, 0.15)
MIDDLE = G // 2
MOST = {QUADRANT: {"agent": 4, "box": 2, "ramp": 1}, FULL: {"agent": 4, "box": 9, "ramp": 2}}
"""Things of a kind in a world."""

Ranges = list[tuple[tuple[int, int], tuple[int, int]]]
"""Rectangles of lowest cells, each as likely, as (first, one past the last) of x and of y."""


def cells_of(size: tuple[float, ...] | np.ndarray) -> np.ndarray:
    """How many cells something of that size, or array of sizes, covers."""
    return np.ceil(np.asarray(size) / CELL).astype(int)


def uniform(cells: np.ndarray) -> Ranges:
    """Anywhere but in the border cells; the last place before them is left out as well."""
    return [((1, G - cells[0] - 1), (1, G - cells[1] - 1))]


def quad(cells: np.ndarray, size: int = MIDDLE) -> Ranges:
    """In the quadrant of high x and low y, of `size` cells, from the column of its wall on."""
    return [((G - size, G - cells[0] - 1), (1, size - cells[1] - 1))]


def outside_quad(cells: np.ndarray, size: int = MIDDLE) -> Ranges:
    """To the left of the quadrant, above that, or above the quadrant, each as likely."""
    left, right = (1, G - size - cells[0] - 1), (G - size, G - cells[0] - 1)
    below, above = (1, size - cells[1] - 1), (size, G - cells[1] - 1)
    return [(left, below), (left, above), (right, above)]


def near(first: np.ndarray, radius: int = NEAR) -> Ranges:
    """Around the lowest cell of another thing, one cell further towards lower ones."""
    return [tuple((max(1, int(c) - radius), min(G - 1, int(c) + radius)) for c in first)]  # type: ignore[list-item]


def chances(ranges: Ranges) -> np.ndarray:
    """(G, G) probabilities of being the lowest cell that is tried."""
    table = np.zeros((G, G))
    for (x0, x1), (y0, y1) in ranges:
        table[x0:x1, y0:y1] += 1 / len(ranges) / ((x1 - x0) * (y1 - y0))
    return table


@dataclass
class World:
    """One world: lower corners in metres by kind, and what else there is to compare."""

    closed: bool
    n_rooms: int
    walls: list[Wall]
    doorways: np.ndarray
    """(doors, 4): first x, first y, last x, last y of their cells."""
    places: dict[str, np.ndarray]
    sizes: np.ndarray
    """(boxes, 2) in metres."""
    drawn: int = 1
    """How many worlds it took."""


def quadrant_walls(rng: np.random.Generator) -> list[Wall]:
    """The two walls of the quadrant; half of the time one of them has no door."""
    walls = [Wall(0, MIDDLE, 0, MIDDLE), Wall(1, MIDDLE, MIDDLE, G - 1)]
    shut = rng.integers(2) if rng.random() < 0.5 else -1
    return [
        wall if i == shut else wall._replace(door_start=wall.start + int(rng.integers(1, wall.end - wall.start - 1)))
        for i, wall in enumerate(walls)
    ]


def pieces(wall: Wall) -> list[tuple[int, int]]:
    """First and last cells of what stands of a wall; a piece of one cell does not."""
    if wall.door_start < 0:
        return [(wall.start, wall.end)]
    halves = [(wall.start, wall.door_start - 1), (wall.door_start + DOOR, wall.end)]
    return [(first, last) for first, last in halves if last > first]


def blocked_by(walls: list[Wall]) -> np.ndarray:
    """(G, G) bool, x first."""
    blocked = np.zeros((G, G), dtype=bool)
    for wall in walls:
        for first, last in pieces(wall):
            own = slice(first, last + 1)
            blocked[(wall.line, own) if wall.axis == 0 else (own, wall.line)] = True
    return blocked


def doorway(wall: Wall) -> tuple[int, int, int, int]:
    """First and last cell of a wall's door."""
    first, last = wall.door_start, wall.door_start + DOOR - 1
    return (wall.line, first, wall.line, last) if wall.axis == 0 else (first, wall.line, last, wall.line)


def place(
    rng: np.random.Generator, blocked: np.ndarray, size: tuple[float, ...], ranges: Ranges
) -> tuple[np.ndarray, np.ndarray] | None:
    """The lowest cell and the lower corner of a thing, which then blocks its cells; None if no place was free."""
    cells = cells_of(size)
    for _ in range(TRIES):
        (x0, x1), (y0, y1) = ranges[rng.integers(len(ranges))]
        x, y = rng.integers(x0, x1), rng.integers(y0, y1)
        own = blocked[x : x + cells[0], y : y + cells[1]]
        if not own.any():
            own[:] = True
            cell = np.array([x, y])
            return cell, cell * CELL + rng.random(2) * (cells * CELL - size)
    return None


def box_sizes(rng: np.random.Generator) -> list[tuple[float, float]]:
    """Three to nine boxes, three or more of them long, these along x first."""
    n = rng.integers(3, MOST[FULL]["box"] + 1)
    n_long = rng.integers(3, n + 1)
    n_along_x = rng.integers(n_long + 1)
    return [LONG] * n_along_x + [LONG[::-1]] * (n_long - n_along_x) + [CUBE] * (n - n_long)


def ranges_of(game: str, kind: str, i: int, size: tuple[float, ...], first: np.ndarray) -> Ranges:
    """Where a thing is tried, by the lowest cell of the first agent of its team."""
    cells = cells_of(size)
    if game == FULL:
        return near(first) if kind == "agent" and i % 2 else uniform(cells)
    if kind == "box":
        return quad(cells)
    return outside_quad(cells) if kind == "agent" and i >= 2 else uniform(cells)


def attempt(rng: np.random.Generator, game: str) -> World | None:
    """One world with counts of its own; None if its walls, or a thing, found no place."""
    full = game == FULL
    n_rooms = int(rng.integers(1, 5)) if full else 2
    drawn = rooms.generate(rng, n_rooms, G) if full else (quadrant_walls(rng),)
    if drawn is None:
        return None
    walls, closed = drawn[0], not full or rng.random() < 0.5
    blocked = blocked_by([*walls, *rooms.outer_walls(G)] if closed else walls)
    sizes = box_sizes(rng) if full else [CUBE] * 2
    places: dict[str, list[np.ndarray]] = {"agent": [], "box": [], "ramp": []}
    first = np.zeros(2, int)
    things = [("agent", AGENT)] * 4 + [("box", size) for size in sizes] + [("ramp", RAMP)] * MOST[game]["ramp"]
    for kind, size in things:
        i = len(places[kind])
        found = place(rng, blocked, size, ranges_of(game, kind, i, size, first))
        if found is None:
            return None
        first = found[0] if kind == "agent" and not i % 2 else first
        places[kind].append(found[1])
    doorways = np.array([doorway(wall) for wall in walls if wall.door_start >= 0], int).reshape(-1, 4)
    return World(closed, n_rooms, walls, doorways, {k: np.array(v) for k, v in places.items()}, np.array(sizes))


def draw(rng: np.random.Generator, game: str) -> World:
    """One world as it begins."""
    drawn = 1
    while (world := attempt(rng, game)) is None:
        drawn += 1
    world.drawn = drawn
    return world


def padded(rows: list[np.ndarray], n: int) -> np.ndarray:
    """(worlds, n, ...) floats, NaN where a world has fewer."""
    out = np.full((len(rows), n, rows[0].shape[-1]), np.nan)
    for i, row in enumerate(rows):
        out[i, : len(row)] = row
    return out


@dataclass
class Starts:
    """How many worlds begin, absent things as NaN; metres and cells as in `World`."""

    game: str
    closed: np.ndarray
    areas: np.ndarray
    """(worlds, 4) free cells of rooms, sorted; NaN beyond the world's number of rooms."""
    doorways: np.ndarray
    agent: np.ndarray
    box: np.ndarray
    ramp: np.ndarray
    sizes: np.ndarray
    drawn: np.ndarray | None = None

    @property
    def n_rooms(self) -> np.ndarray:
        return (~np.isnan(self.areas)).sum(axis=1)


def starts(rng: np.random.Generator, game: str, n: int) -> Starts:
    """Many worlds of a game."""
    worlds = [draw(rng, game) for _ in range(n)]
    areas = [np.sort(rooms.room_areas(world.walls, G))[:, None].astype(float) for world in worlds]
    places = {kind: padded([world.places[kind] for world in worlds], most) for kind, most in MOST[game].items()}
    return Starts(
        game,
        np.array([world.closed for world in worlds]),
        padded(areas, 4)[..., 0],
        padded([world.doorways for world in worlds], 3),
        **places,
        sizes=padded([world.sizes for world in worlds], MOST[game]["box"]),
        drawn=np.array([world.drawn for world in worlds]),
    )


def lowest(place: np.ndarray) -> np.ndarray:
    """The lowest cell of what has its lower corner there, as floats."""
    return np.floor(place / CELL + 1e-3)


def in_doorway(worlds: Starts) -> np.ndarray:
    """(worlds,) bool: something covers a cell of a doorway."""
    found = []
    for place, size in ((worlds.agent, AGENT), (worlds.box, worlds.sizes), (worlds.ramp, RAMP)):
        first = lowest(place)[:, :, None]
        last = first + np.ceil(np.broadcast_to(size, place.shape) / CELL - 1e-3)[:, :, None] - 1
        begins, ends = worlds.doorways[:, None, :, :2], worlds.doorways[:, None, :, 2:]
        shared = np.logical_and(first <= ends, begins <= last)
        found.append(np.any(np.all(shared, axis=-1), axis=(1, 2)))
    return np.logical_or.reduce(found)


def statistics(worlds: Starts) -> dict[str, np.ndarray]:
    """Samples by name, each with one value per world at most; counts and truths as integers."""
    full, counted = worlds.game == FULL, ~np.isnan(worlds.box[..., 0])
    there = ~np.isnan(worlds.doorways[..., 0])
    doors = worlds.doorways[there.any(axis=1)]
    out: dict[str, np.ndarray] = {
        "in a doorway": in_doorway(worlds).astype(int),
        "doors": there.sum(axis=1),
        "doors: lowest x": np.nanmin(doors[..., 0], axis=1).astype(int),
        "doors: highest y": np.nanmax(doors[..., 3], axis=1).astype(int),
    }
    if full:
        out["rooms"] = worlds.n_rooms
        out["boxes"] = counted.sum(axis=1)
        out["long boxes"] = (worlds.sizes.max(axis=-1, initial=0, where=counted[..., None]) > 1).sum(axis=1)
        for rank in range(4):
            out[f"area {rank} of 4"] = worlds.areas[worlds.n_rooms == 4, rank]
        for i, team in ((0, "hiders"), (2, "seekers")):
            gap = np.abs(worlds.agent[:, i + 1] - worlds.agent[:, i])
            out[f"{team}: distance"] = np.linalg.norm(gap, axis=-1)
    else:
        middle = worlds.agent + np.array(AGENT) / 2 > G * CELL / 2
        for i in (2, 3):
            area = np.where(middle[:, i, 0], 2 + ~middle[:, i, 1], middle[:, i, 1])
            out[f"agent {i}: area"] = area
        out["hider 0 in the quadrant"] = (middle[:, 0, 0] & ~middle[:, 0, 1]).astype(int)
        ramp = worlds.ramp[:, 0] + np.array(RAMP) / 2 > G * CELL / 2
        out["ramp in the quadrant"] = (ramp[:, 0] & ~ramp[:, 1]).astype(int)
    arenas = (("closed", worlds.closed), ("open", ~worlds.closed)) if full else (("closed", worlds.closed),)
    things = [(kind, i) for kind in MOST[worlds.game] for i in range(MOST[worlds.game][kind])]
    for kind, i in things:
        for arena, those in arenas:
            place = getattr(worlds, kind)[those, i]
            place = place[~np.isnan(place[:, 0])]
            if len(place):
                out |= {f"{kind} {i}, {arena}: {axis}": place[:, k] for k, axis in enumerate("xy")}
    return out
