"""Object counting: boxes pass behind screens, and the agent is to know how many went to each side (Baker et al.).

The paper's text describes the task; its appendix with the numbers was not found, and it is in none of the published
code. So the places, the speeds and the steps here are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import radians, tan
from typing import Annotated

import jax

from maax_mjx.common.annotated import Count, NonNegativeRange, OneOf, Positive, PositiveCount
from maax_mjx.common.checks import check_count_range
from maax_mjx.core.composition import FloorSize, GridSize
from maax_mjx.core.env import Environment
from maax_mjx.layout import HORIZONTAL, Rooms, Walls, at_placement, register_scenario
from maax_mjx.modules.walls import OUTER
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.hide_and_seek import arguments
from maax_mjx.tasks.standard import Number, Placement, Placements, ScenarioNames
from maax_mjx.tasks.transfer.common import BoxesConfig, as_in_hide_and_seek, one_agent
from maax_mjx.wrappers import ObjectCounting

SCREENS = "screens"
FLOOR, CELLS = 9.0, 90
"""Metres and cells of the floor's edge: cells into which boxes and the agent fit exactly, so that they start on their
lanes."""
AGENT = (4.55, 8.35)
"""Metres; it looks towards low y, at yaw 0, through the middle of the gap."""
LANES = tuple(zip((1.6, 2.2, 2.8, 3.4, 4.0, 4.6), (-27.0, 27.0, -14.0, 14.0, -5.5, 5.5), strict=True))
"""How far ahead of the agent a box crosses, in metres, and where it stands at first, in degrees from straight ahead."""


def screens(key: jax.Array, grid_size: int) -> Rooms:
    """One room, with two walls near high y and a gap of a ninth of the floor between them."""
    last, row = grid_size - 1, grid_size * 76 // 90
    walls = Walls.create([HORIZONTAL] * 2, [row] * 2, [0, grid_size * 50 // 90], [grid_size * 40 // 90, last])
    return Rooms.create(walls, [(0, 0, last, last)])


register_scenario(SCREENS, screens, n_walls=2, n_rooms=1, shortest_wall=lambda g: g * 39 // 90, fixed_walls=True)


@dataclass(frozen=True)
class PassagesConfig(Config):
    """Arguments of `ObjectCounting`."""

    speed: Positive = 3.0
    margin: Positive = 0.3
    last_start: Count = 40


@dataclass(frozen=True)
class CountingConfig(BoxesConfig):
    """Six boxes, each of which goes behind one of two screens; the agent cannot move.

    There is no reward: `maax-mjx bench counting` asks what the memory knows. From step 65 on no box is seen, and no ray
    of the lidar meets one.

    Attributes:
        box_placement: None is a lane for each box.
        floor_size: only as they are.
        grid_size: only as they are.
        task: arguments of the wrapper.
    """

    scenario: ScenarioNames = SCREENS
    door_size: Count = 0
    outer: Annotated[str, OneOf(OUTER)] = "none"
    n_boxes: Number = 6
    box_placement: Placements | None = None  # type: ignore[assignment]
    agent_placement: Placement = field(default_factory=lambda: at_placement(*AGENT))
    box_friction: NonNegativeRange | None = 0.0
    floor_friction: NonNegativeRange | None = 0.0
    grid_size: GridSize = CELLS
    floor_size: FloorSize = FLOOR
    horizon: PositiveCount | None = 120
    task: PassagesConfig = field(default_factory=PassagesConfig)


def object_counting(config: CountingConfig) -> Environment:
    """Builds the counting task.

    Raises:
        ValueError: more boxes than lanes, another floor, `published=True`, or a config that the world or the wrappers
            refuse.
    """
    if config.published:
        raise ValueError("published: got True; object_counting takes False, as the paper's task was not published")
    if (config.floor_size, config.grid_size) != (FLOOR, CELLS):
        raise ValueError(
            f"floor_size, grid_size: got {config.floor_size} and {config.grid_size}; object_counting takes {FLOOR} and "
            f"{CELLS}, for which its screens are made"
        )
    n = check_count_range("n_boxes", config.n_boxes)[1]
    if config.box_placement is None:
        if n > len(LANES):
            raise ValueError(f"n_boxes: got {config.n_boxes}; object_counting takes up to {len(LANES)}, one a lane")
        config = replace(config, box_placement=[_start(*lane) for lane in LANES[:n]])
    env = ObjectCounting(one_agent(config), **arguments(config.task))
    return as_in_hide_and_seek(env, config, n_others=2, hider=False)


def _start(ahead: float, angle: float) -> Placement:
    """Where a box stands at first."""
    return at_placement(AGENT[0] + ahead * tan(radians(angle)), AGENT[1] - ahead)
