"""The standard environment M of the thesis (section 6.3, formula 6.1)."""

from __future__ import annotations

from collections.abc import Sequence

from maax_mjx.base import Base
from maax_mjx.checks import check_count_range
from maax_mjx.layout import PlacementFn, outside_quad_placement, quad_placement, uniform_placement
from maax_mjx.modules import Agents, Boxes, Ramps, WallScenarios
from maax_mjx.worldgen import WorldParams

HIDER, SEEKER = (0.0, 0.447, 0.698, 1.0), (0.835, 0.369, 0.0, 1.0)


def standard(
    scenario: str | Sequence[str] = "quad",
    n_hiders: int | tuple[int, int] = 2,
    n_seekers: int | tuple[int, int] = 2,
    n_boxes: int | tuple[int, int] = 1,
    n_ramps: int | tuple[int, int] = 1,
    door_size: int = 2,
    p_door_dropout: float | tuple[float, float] = 0.0,
    n_rooms: int | tuple[int, int] = 4,
    min_room_size: int = 6,
    n_frames: int = 1,
    grid_size: int = 30,
    floor_size: float | tuple[float, float] = 6.0,
    outer: str = "walls",
    probabilities: Sequence[float] | None = None,
    horizon: int = 1000,
    impl: str = "auto",
    world_params: WorldParams | None = None,
    contacts_per_world: int | None = None,
) -> Base:
    """M = [(2, 2), quad, 1, 1]: 2 hiders, 2 seekers, quadrant walls with doors, outer walls, 1 box, 1 ramp.

    Hiders come first among the agents. Where there is a quadrant they start inside it and seekers outside;
    everything else starts anywhere.

    Args:
        scenario: the room scenario, or several of which every world draws one; see `WallScenarios`.
        n_hiders, n_seekers: agents of each team per world, or (low, high).
        n_boxes, n_ramps: per world, or (low, high).
        door_size: in cells.
        outer: what closes the arena; see `WallScenarios`.
        probabilities: of the scenarios, where there are several.
        p_door_dropout, n_rooms, min_room_size: see `WallScenarios`.
        n_frames, grid_size, floor_size, horizon, impl, world_params, contacts_per_world: see `Base`.
    """
    most_hiders = check_count_range("n_hiders", n_hiders)[1]
    most_seekers = check_count_range("n_seekers", n_seekers)[1]
    n_agents = most_hiders + most_seekers
    if not n_agents:
        raise ValueError(f"n_hiders, n_seekers: got {n_hiders} and {n_seekers}; takes at least one agent in all")
    env = Base(n_agents, n_frames, grid_size, floor_size, horizon, impl, world_params, contacts_per_world)
    inside: PlacementFn = uniform_placement
    outside: PlacementFn = uniform_placement
    walls = WallScenarios(scenario, door_size, p_door_dropout, probabilities, n_rooms, min_room_size, outer=outer)
    if walls.provides_quadrant:
        inside, outside = quad_placement, outside_quad_placement
    env.add_module(walls)
    env.add_module(
        Agents(
            {"hiders": n_hiders, "seekers": n_seekers},
            [inside] * most_hiders + [outside] * most_seekers,
            [HIDER] * most_hiders + [SEEKER] * most_seekers,
        )
    )
    env.add_module(Boxes(n_boxes))
    env.add_module(Ramps(n_ramps))
    return env
