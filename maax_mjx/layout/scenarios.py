"""Room scenarios by name: the thesis's (4.3.3), and those that users add."""

from __future__ import annotations

from collections.abc import Callable

import jax

from maax_mjx.common.checks import check_bool, check_choice, check_count, check_new_name, check_takes
from maax_mjx.layout.fixed_rooms import LARGEST, SMALLEST, SPLITS, empty, half, quad, tri, var_quad
from maax_mjx.layout.random_rooms import RandomRooms
from maax_mjx.layout.rooms import Rooms
from maax_mjx.layout.scenario import Cells, FixedScenario, Scenario

_SCENARIOS: dict[str, Scenario] = {"random": RandomRooms()}


def scenario_names() -> list[str]:
    """The names that `WallScenarios` takes."""
    return sorted(_SCENARIOS)


def scenario_by_name(name: str) -> Scenario:
    """A scenario that was registered.

    Raises:
        ValueError: an unknown name, with the nearest ones.
    """
    return _SCENARIOS[check_choice("scenario", name, _SCENARIOS)]


def register_scenario(
    name: str,
    draw: Callable[[jax.Array, int], Rooms],
    *,
    n_walls: int,
    n_rooms: int,
    shortest_wall: Cells | None = None,
    narrowest_room: Cells | None = None,
    wall_cells: Cells | None = None,
    quadrant_cells: Cells | None = None,
    fixed_doors: bool = True,
    fixed_walls: bool = False,
) -> None:
    """Gives a room scenario of your own a name, which `WallScenarios` and the configs of games then take.

    Every inner wall gets a door, so that rooms are joined if every wall between two crossings is a wall of its own.

    Example:
        ```python
        from maax_mjx.layout import HORIZONTAL, VERTICAL, Rooms, Walls, register_scenario

        def cross(key, grid_size):
            m, last = grid_size // 2, grid_size - 1
            axes = [VERTICAL, VERTICAL, HORIZONTAL, HORIZONTAL]
            walls = Walls.create(axes, line=[m] * 4, start=[0, m, 0, m], end=[m, last, m, last])
            rooms = [(0, 0, m, m), (m, 0, last, m), (0, m, m, last), (m, m, last, last)]
            return Rooms.create(walls, rooms)

        register_scenario("cross", cross, n_walls=4, n_rooms=4, shortest_wall=lambda grid_size: (grid_size + 1) // 2)
        env = maax.make("hide_and_seek", scenario="cross", hider_placement="room0")
        ```

    Args:
        name: a new one.
        draw: `(key, grid_size) -> Rooms`, pure JAX, for a grid of `grid_size` cells per side.
        n_walls: how many inner walls it draws, absent ones included.
        n_rooms: how many rectangular rooms it draws, absent ones included.
        shortest_wall: from `grid_size` to the cells of the shortest stretch of a wall between two others, theirs
            included, so that a door that does not fit is refused when an environment is composed. None: it makes the
            layout invalid.
        narrowest_room: from `grid_size` to the cells across the narrowest room, the walls on both sides included, so
            that a floor is refused where agents do not fit into it. None is as many as the shortest wall has.
        wall_cells: from `grid_size` to how many cells its walls take at the most. None: all go from side to side.
        quadrant_cells: from `grid_size` to how many cells its quadrant has at the least; None has no quadrant. Room 0
            is the quadrant, and the first two walls are its walls.
        fixed_doors: whether every wall is there, with its door, in every world; else `door_mask` is observed.
        fixed_walls: whether the walls stand at the same places in every world, whatever the key, so that a placement
            that they leave no place is refused when an environment is composed.

    Raises:
        ValueError: a name that is taken, what is not a function, or a wrong number. An environment that draws the
            scenario raises one if `draw` returns something else than was registered.
    """
    n_walls, n_rooms = check_count("n_walls", n_walls), check_count("n_rooms", n_rooms, minimum=1)
    if not callable(draw):
        raise ValueError(f"draw: got {draw!r}; takes a function (key, grid_size) -> Rooms")
    check_takes("draw", draw, ("key", "grid_size"), "Rooms")
    cells = {
        "shortest_wall": shortest_wall,
        "narrowest_room": narrowest_room,
        "wall_cells": wall_cells,
        "quadrant_cells": quadrant_cells,
    }
    for argument, value in cells.items():
        if value is not None and not callable(value):
            raise ValueError(f"{argument}: got {value!r}; takes a function grid_size -> cells, or None")
    if quadrant_cells is not None and n_walls < 2:
        raise ValueError(f"n_walls: got {n_walls} beside quadrant_cells; takes at least the quadrant's 2")
    drawn_by = {taken: getattr(scenario, "draw_rooms", None) for taken, scenario in _SCENARIOS.items()}
    _SCENARIOS[name] = FixedScenario(
        name=check_new_name(name, drawn_by, draw),
        draw_rooms=draw,
        n_walls=n_walls,
        n_rooms=n_rooms,
        shortest_wall=shortest_wall,
        narrowest_room=shortest_wall if narrowest_room is None else narrowest_room,
        wall_cells=(lambda grid_size: n_walls * grid_size) if wall_cells is None else wall_cells,
        quadrant_cells=quadrant_cells,
        fixed_doors=check_bool("fixed_doors", fixed_doors),
        fixed_walls=check_bool("fixed_walls", fixed_walls),
    )


def _cells_inside(quadrant: int) -> int:
    """How many cells a quadrant of so many cells per side has between its walls and the outer ones."""
    return (quadrant - 1) * (quadrant - 2)


register_scenario("empty", empty, n_walls=0, n_rooms=1, fixed_walls=True)
register_scenario(
    "half",
    half,
    n_walls=1,
    n_rooms=2,
    shortest_wall=lambda g: g,
    narrowest_room=lambda g: g - g // 2,
    fixed_walls=True,
)
register_scenario(
    "quad",
    quad,
    n_walls=2,
    n_rooms=1,
    shortest_wall=lambda g: g // 2,
    wall_cells=lambda g: 2 * (g // 2),
    quadrant_cells=lambda g: _cells_inside(g // 2),
    fixed_walls=True,
)
register_scenario(
    "var_quad",
    var_quad,
    n_walls=2,
    n_rooms=1,
    shortest_wall=lambda g: int(SMALLEST * g),
    wall_cells=lambda g: 2 * int(LARGEST * g),
    quadrant_cells=lambda g: _cells_inside(int(SMALLEST * g)),
)
register_scenario("tri", tri, n_walls=2, n_rooms=3, shortest_wall=lambda g: g - int(SPLITS[1] * g))
