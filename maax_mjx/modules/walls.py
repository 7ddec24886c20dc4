"""Walls and doors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.checks import (
    check_bool,
    check_choice,
    check_count,
    check_count_range,
    check_fraction,
    check_positive,
)
from maax_mjx.common.observed import POSITION, Column, Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, World
from maax_mjx.layout import walls as wall_layout
from maax_mjx.layout.grid import Grid
from maax_mjx.layout.redraw import redraw
from maax_mjx.layout.rooms import Rooms, with_doors
from maax_mjx.layout.scenario import Cells, Scenario
from maax_mjx.layout.scenarios import scenario_by_name
from maax_mjx.modules.from_model import from_model
from maax_mjx.modules.module import BELOW, Module
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Overlay
from maax_mjx.physics.overlay import BOX_FIELDS, set_boxes
from maax_mjx.worldgen import Floor, Geom

OUTER_HEIGHT, INNER_HEIGHT = 4.0, 0.5
"""Metres."""
BACKING = 1.0
"""Metres by which outer walls reach beyond the floor, in the physics and not in pictures."""
OUTER = ("walls", "limits", "none")
WAY = 0.32
"""Metres of opening that agents of 0.3 m can pass."""


class WallScenarios(Module):
    """Outer walls, and the inner walls of the thesis's room scenarios (thesis 4.3.3), drawn per world.

    Walls are geoms of the world body, half a cell thick, on grid lines. An absent piece of wall lies deep below the
    floor. A batch of mixed scenarios shares one compiled model.

    Args:
        scenario: "empty" (outer walls only), "half" (two rooms), "quad" (a quadrant at high x, low y, with a door in
            each wall), "var_quad" (its size drawn), "tri" (three rooms), "random" (see `n_rooms`), one of your own
            (see `layout.register_scenario`), or several of these; each world then draws one.
        door_size: doors in cells; the true opening is one cell and a thickness wider, and half a cell less beside
            another wall. 0 makes walls without doors.
        p_door_dropout: probability that only one of a quadrant's walls has a door, or (low, high).
        probabilities: probabilities of several scenarios; None makes them equal.
        n_rooms: number of rooms of "random", or (low, high), drawn uniformly.
        min_room_size: for "random", in cells: rooms are longer than this on every side that a new wall makes.
        prob_outside_walls: probability that a world has outer walls, or (low, high).
        low_outside_walls: whether outer walls are 0.5 m high, as inner walls are, instead of 4 m.
        friction: sliding friction of the walls, or a range drawn per world; None keeps MuJoCo's default of 1.
        outer: how the arena is closed: "walls"; "limits", joint ranges of movable entities, which cost no contacts; or
            "none", an open floor.
        outer_height: height of the outer walls in metres, where they are not low.
        in_doorways: whether things may start in doorways, as in the published code.

    Raises:
        ValueError: an unknown scenario, a negative size, or a share outside [0, 1]; with `Base`, a door wider than its
            wall, or too narrow for an agent.
    """

    name = "walls"

    def __init__(
        self,
        scenario: str | Sequence[str] = "quad",
        door_size: int = 2,
        p_door_dropout: float | tuple[float, float] = 0.0,
        probabilities: Sequence[float] | None = None,
        n_rooms: int | tuple[int, int] = 4,
        min_room_size: int = 6,
        prob_outside_walls: float | tuple[float, float] = 1.0,
        low_outside_walls: bool = False,
        friction: float | tuple[float, float] | None = None,
        outer: str = "walls",
        in_doorways: bool = False,
        outer_height: float = OUTER_HEIGHT,
    ):
        self.in_doorways = check_bool("in_doorways", in_doorways)
        names: list = list(scenario) if isinstance(scenario, list | tuple) else [scenario]
        if not names:
            raise ValueError("scenario: got none; takes at least one")
        self.n_rooms = check_count_range("n_rooms", n_rooms, minimum=1)
        self.min_room_size = check_count("min_room_size", min_room_size, minimum=1)
        self._drawn = [scenario_by_name(name).sized(self.n_rooms, self.min_room_size) for name in names]
        self.scenarios: list[str] = names
        self.provides_quadrant = any(scenario.quadrant_cells for scenario in self._drawn)
        self.door_size = check_count("door_size", door_size)
        self.p_door_dropout = check_fraction("p_door_dropout", p_door_dropout)
        if self.p_door_dropout[1] > 0 and not (self.provides_quadrant and self.door_size):
            raise ValueError(f"p_door_dropout: got {p_door_dropout!r} without a quadrant's doors; takes 0 there")
        self.probabilities = _check_probabilities(probabilities, len(names))
        self.prob_outside_walls = check_fraction("prob_outside_walls", prob_outside_walls)
        self.friction = None if friction is None else Ranged("wall_friction", friction, argument="friction")
        self.outer = check_choice("outer", outer, OUTER)
        self.limits_arena = outer == "limits"
        # What climbs onto low walls falls off them on the other side.
        self._low = low = check_bool("low_outside_walls", low_outside_walls)
        if outer != "walls" and (low or self.prob_outside_walls != (1.0, 1.0)):
            raise ValueError(
                f"low_outside_walls, prob_outside_walls: got {low} and {prob_outside_walls!r}; takes False and 1 with "
                f"outer={outer!r}, as there are no outer walls"
            )
        self.n_inner = max(scenario.n_walls for scenario in self._drawn)
        self.max_rooms = max(scenario.n_rooms for scenario in self._drawn)
        self.n_outer = 4 if outer == "walls" else 0
        self.n_walls = self.n_outer + 2 * self.n_inner
        height = INNER_HEIGHT if low else check_positive("outer_height", outer_height)
        self._heights = np.array([height] * self.n_outer + [INNER_HEIGHT] * 2 * self.n_inner, np.float32)

    @property
    def parameters(self) -> list[Parameter]:
        parameters = [] if self.friction is None else self.friction.parameters
        if self.n_outer:
            parameters.append(Parameter("prob_outside_walls", self.prob_outside_walls, (0.0, 1.0)))
        if self.provides_quadrant and self.door_size:
            parameters.append(Parameter("p_door_dropout", self.p_door_dropout, (0.0, 1.0)))
        return parameters + [p for scenario in self._drawn for p in scenario.parameters]

    @property
    def overlay(self) -> Overlay:
        varies = self.friction is not None and self.friction.varies
        return dict.fromkeys(BOX_FIELDS + ("geom_friction",) * varies, self.geom_ids)

    @from_model
    def geom_ids(self) -> np.ndarray:
        """Geom ids (n_walls,) of the outer walls, followed by both pieces of every inner wall."""
        return np.array([self.model.geom(f"wall{i}").id for i in range(self.n_walls)], int)

    def check(self, grid_size: int, floor_size: float) -> None:
        for scenario in self._drawn:
            scenario.check(grid_size)
        if self.n_inner and self.door_size:
            self._check_doors(grid_size, floor_size / grid_size)

    def _check_doors(self, grid_size: int, cell: float) -> None:
        """Refuses doors wider than their wall, and doors and rooms too narrow for an agent, by the cells' size in m."""
        walled = [scenario for scenario in self._drawn if scenario.n_walls]
        walls = [_known(scenario.shortest_wall, grid_size) for scenario in walled]
        rooms = [_known(scenario.narrowest_room, grid_size) for scenario in walled]
        sides = [room if wall is None else wall for wall, room in zip(walls, rooms, strict=True)]
        shortest = min((side for side in sides if side is not None), default=self.door_size + 2)
        if self.door_size > shortest - 2:
            raise ValueError(
                f"door_size: got {self.door_size} cells; takes 0 to {shortest - 2}, so that the shortest wall, of "
                f"{shortest} cells, keeps one on either side"
            )
        opening = cell * min(wall_layout.narrowest_opening(self.door_size, wall) for wall in walls)
        if opening < WAY:
            raise ValueError(
                f"door_size: got {self.door_size} cells, an opening of {opening:.2f} m where it is narrowest, on the "
                f"smallest floor; takes one of at least {WAY} m, so that agents pass"
            )
        # From the middle of one wall's cells to the middle of the other's, less a thickness of half a cell.
        width = cell * (min((room for room in rooms if room is not None), default=np.inf) - 1.5)
        if width < WAY:
            raise ValueError(
                f"floor_size: got {cell * grid_size:.2f} m at the least, with a room {width:.2f} m wide; takes one "
                f"with rooms of at least {WAY} m, so that agents fit"
            )

    def wall_cells(self, grid_size: int) -> int:
        outer = 4 * grid_size - 4 if self.n_outer else 0
        return outer + max(scenario.wall_cells(grid_size) for scenario in self._drawn)

    def fixed_cells(self, grid_size: int) -> np.ndarray:
        cells = np.logical_and.reduce([_fixed_cells(scenario, grid_size) for scenario in self._drawn])
        if self.n_outer and self.prob_outside_walls[0] == 1:
            cells[[0, -1]] = cells[:, [0, -1]] = True
        return cells

    def quadrant_cells(self, grid_size: int) -> int:
        sizes = [scenario.quadrant_cells(grid_size) for scenario in self._drawn if scenario.quadrant_cells]
        return min(sizes, default=0)

    def build_step(self, floor: Floor, grid_size: int) -> None:
        edge = float(floor.edges[0])  # that of a square
        thick = edge / grid_size / 2
        for i, height in enumerate(self._heights):
            size = (edge / 2, thick, float(height))
            friction = self.friction.high if self.friction else None
            wall = Geom("box", size, name=f"wall{i}", friction=friction, rgba=(0.6, 0.6, 0.62, 1.0))
            floor.append(wall.mark_static(), "parking")

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        cell, g = layout.grid.cell, layout.grid.size
        # Draws of counts and kinds depend only on the key, so that a redraw of places does not change them.
        which_key, count_key, outer_key, probability_key, place_key = jax.random.split(key, 5)
        place_key = jax.random.fold_in(place_key, layout.attempt)
        which = jnp.zeros((), jnp.int32)
        if len(self.scenarios) > 1:
            which = jax.random.choice(which_key, len(self.scenarios), p=jnp.asarray(self.probabilities))
        rooms = self._draw_rooms(which, count_key, place_key, g, params)
        closed = jnp.asarray(self.limits_arena)
        if self.n_outer:
            closed = jax.random.uniform(outer_key) < params.draw(probability_key, "prob_outside_walls")
        outer = wall_layout.outer_walls(g, closed & (self.n_outer > 0))
        outer_rects, outer_there = wall_layout.segments(outer, cell)
        inner_rects, inner_there = wall_layout.segments(rooms.walls, cell)
        rects = jnp.concatenate([outer_rects[: self.n_outer, 0], inner_rects.reshape(-1, 4)])
        mask = jnp.concatenate([outer_there[: self.n_outer, 0], inner_there.reshape(-1)])
        cells = jnp.concatenate([rooms.rooms[:, :2] + 1, rooms.rooms[:, 2:]], axis=1)
        cells = jnp.where(rooms.room_mask[:, None], cells, 0)
        plan = layout.plan.replace(
            walls=jnp.where(mask[:, None], rects, 0.0),
            wall_heights=jnp.where(mask, self._heights, 0.0),
            wall_mask=mask,
            doors=wall_layout.openings(rooms.walls, cell),
            door_mask=rooms.walls.present & (rooms.walls.door_cells > 0),
            quadrant=jnp.where(rooms.quadrant, cells[0], 0),
            rooms=cells,
            room_mask=rooms.room_mask,
            scenario=which,
            closed=closed,
        )
        backed = rects
        if not self._low:
            backed = rects.at[: self.n_outer].set(_backed(rects[: self.n_outer], cell, g))
        pos, half = _box_geometry(backed, jnp.asarray(self._heights), mask)
        fields = layout.fields
        if self.n_walls:
            fields = set_boxes(fields, self.geom_ids, half)
            fields["geom_pos"] = with_rows(fields["geom_pos"], self.geom_ids, pos)
        if self.n_walls and self.friction is not None and self.friction.varies:
            sliding = self.friction.draw(key, params, self.n_walls, shared=True)
            fields["geom_friction"] = fields["geom_friction"].at[self.geom_ids, 0].set(sliding)
        return layout.replace(
            grid=wall_layout.mark(wall_layout.mark(layout.grid, outer), rooms.walls, not self.in_doorways),
            plan=plan,
            fields=fields,
        ).noting(self.name, ~rooms.valid)

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns `door_obs` (n_doors, 3): x, y of the middle and the width of every true opening, in metres.

        Also `door_mask` (n_doors,) where a world may have fewer doors; absent doors are zero.
        """
        if not self.n_inner or not self.door_size:
            return {}
        doors = {"door_obs": world.plan.doors}
        return doors if self._doors_are_fixed else doors | {"door_mask": world.plan.door_mask}

    def declared(self) -> dict[str, Observed]:
        if not self.n_inner or not self.door_size:
            return {}
        doors = {"door_obs": Observed(("door",), (*POSITION[:2], Column("width", "m")))}
        return doors if self._doors_are_fixed else doors | {"door_mask": Observed(("door",))}

    @property
    def _doors_are_fixed(self) -> bool:
        return len(self._drawn) == 1 and self._drawn[0].fixed_doors and not self.provides_quadrant

    def _draw_rooms(
        self, which: jax.Array, count_key: jax.Array, key: jax.Array, grid_size: int, params: DomainParams
    ) -> Rooms:
        """Draws rooms with doors, again where they may fit badly, so that the rest of the layout is not redrawn."""
        tries = max(scenario.tries for scenario in self._drawn)
        if tries == 1:
            return self._draw_once(which, count_key, key, grid_size, params)

        def draw(attempt: jax.Array) -> Rooms:
            return self._draw_once(which, count_key, jax.random.fold_in(key, attempt), grid_size, params)

        return redraw(draw, tries, key)

    def _draw_once(
        self, which: jax.Array, count_key: jax.Array, key: jax.Array, grid_size: int, params: DomainParams
    ) -> Rooms:
        draw_key, door_key, drop_key = jax.random.split(key, 3)
        drawn = [
            scenario.draw(draw_key, count_key, grid_size, params).padded(self.n_inner, self.max_rooms)
            for scenario in self._drawn
        ]
        rooms = jax.tree.map(lambda *x: jnp.stack(x)[which], *drawn)
        if not self.door_size:
            return rooms
        dropout = params.draw(drop_key, "p_door_dropout") if "p_door_dropout" in params else None
        return with_doors(door_key, rooms, self.door_size, dropout, grid_size)


class RandomWalls(WallScenarios):
    """Rooms by recursive splitting, every inner wall with a door (OpenAI's RandomWalls; thesis 4.3.3).

    Args:
        n_rooms: number of rooms, or (low, high), drawn uniformly.
        min_room_size: in cells; new walls keep further than this from the corners of the room that they split.
        door_size: see `WallScenarios`.
        prob_outside_walls: see `WallScenarios`.
        low_outside_walls: see `WallScenarios`.
        friction: see `WallScenarios`.
        outer: see `WallScenarios`.
        in_doorways: see `WallScenarios`.
        outer_height: see `WallScenarios`.
        random_room_count: whether to draw 1 to `n_rooms` rooms: the same as `n_rooms=(1, n_rooms)`.
        outside_walls: False is the same as `outer="none"`.

    Raises:
        ValueError: as in `WallScenarios`; also `random_room_count` with a range, or `outside_walls=False` with limits.
    """

    def __init__(
        self,
        n_rooms: int | tuple[int, int] = 4,
        min_room_size: int = 6,
        door_size: int = 2,
        prob_outside_walls: float | tuple[float, float] = 1.0,
        low_outside_walls: bool = False,
        friction: float | tuple[float, float] | None = None,
        outer: str = "walls",
        *,
        in_doorways: bool = False,
        outer_height: float = OUTER_HEIGHT,
        random_room_count: bool = False,
        outside_walls: bool = True,
    ):
        if check_bool("random_room_count", random_room_count):
            n_rooms = (1, check_count("n_rooms", n_rooms, minimum=1))
        if not check_bool("outside_walls", outside_walls) and outer == "limits":
            raise ValueError("outside_walls: got False with outer='limits'; takes True there")
        super().__init__(
            "random",
            door_size,
            n_rooms=n_rooms,
            min_room_size=min_room_size,
            prob_outside_walls=prob_outside_walls,
            low_outside_walls=low_outside_walls,
            friction=friction,
            outer=outer if outside_walls else "none",
            in_doorways=in_doorways,
            outer_height=outer_height,
        )


@cache
def _fixed_cells(scenario: Scenario, grid_size: int) -> np.ndarray:
    """Returns the cells (G, G) bool that a scenario's inner walls take, if they take the same in every world."""
    if not (scenario.fixed_walls and scenario.n_walls):
        return np.zeros((grid_size, grid_size), bool)

    @jax.jit
    def cells(key: jax.Array) -> jax.Array:
        walls = scenario.draw(key, key, grid_size, DomainParams({})).walls
        return wall_layout.mark(Grid.create(grid_size, 1.0), walls).occupancy() > 0

    return np.array(cells(jax.random.key(0)))


def _known(cells: Cells | None, grid_size: int) -> int | None:
    return None if cells is None else cells(grid_size)


def _check_probabilities(values: Sequence[float] | None, n: int) -> tuple[float, ...]:
    if values is None:
        return (1 / n,) * n
    try:
        given = [float(v) for v in values]
    except (TypeError, ValueError):
        given = []
    if len(given) != n or not all(v >= 0 for v in given) or not abs(sum(given) - 1) <= 1e-6:
        raise ValueError(f"probabilities: got {values!r}; takes {n} of at least 0 that sum to 1, one per scenario")
    return tuple(given)


def _backed(rects: jax.Array, cell: jax.Array, grid_size: int) -> jax.Array:
    """Returns outer walls (n, 4), which stand in the cells at the edge, as they reach `BACKING` beyond the floor.

    What is pressed deeper into a wall than to its middle leaves it on the other side.
    """
    low, high = rects[:, :2], rects[:, 2:]
    edge = cell * grid_size
    low = jnp.where(low < cell, -BACKING, low)
    high = jnp.where(high > edge - cell, edge + BACKING, high)
    return jnp.concatenate([low, high], axis=1)


def _box_geometry(rects: jax.Array, heights: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns centres and half extents (n, 3) of walls standing on the floor; absent walls are tiny, far below it."""
    low, high = rects[:, :2], rects[:, 2:]
    pos = jnp.concatenate([(low + high) / 2, heights[:, None] / 2], axis=1)
    half = jnp.concatenate([(high - low) / 2, heights[:, None] / 2], axis=1)
    parked = jnp.concatenate([pos[:, :2], jnp.full_like(pos[:, :1], BELOW)], axis=1)
    return jnp.where(mask[:, None], pos, parked), jnp.where(mask[:, None], half, 0.01)
