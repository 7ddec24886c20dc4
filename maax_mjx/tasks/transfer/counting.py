"""Object counting: boxes pass behind screens, and the agent is to know how many went to each side (Baker et al.).

The paper's text describes the task; its appendix with the numbers was not found, and it is in none of the published
code. So the places, the speeds and the steps here are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import radians, tan
from typing import Annotated

import jax

from maax_mjx.common.annotated import Count, NonNegativeRange, OneOf, Positive, PositiveCount
from maax_mjx.core.composition import GridSize
from maax_mjx.core.env import Environment
from maax_mjx.layout import HORIZONTAL, Rooms, Walls, at_placement, register_scenario
from maax_mjx.modules.walls import OUTER
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.hide_and_seek import arguments
from maax_mjx.tasks.standard import Number, Placement, Placements, ScenarioNames
from maax_mjx.tasks.transfer.common import BoxesConfig, as_in_hide_and_seek, one_agent
from maax_mjx.wrappers import ObjectCounting

SCREENS = "screens"
AGENT = (3.05, 5.35)
"""Metres; it looks towards low y, at yaw 0."""
LANES = tuple(zip((1.6, 2.2, 2.8, 3.4, 4.0, 4.6), (-27.0, 27.0, -14.0, 14.0, -5.5, 5.5), strict=True))
"""How far ahead of the agent a box crosses, in metres, and where it stands at first, in degrees from straight ahead."""


def screens(key: jax.Array, grid_size: int) -> Rooms:
    """One room, with two walls near high y and a gap of two fifteenths of the floor between them."""
    last, row, half = grid_size - 1, grid_size * 23 // 30, grid_size * 2 // 30
    middle = grid_size // 2
    walls = Walls.create([HORIZONTAL] * 2, [row] * 2, [0, middle + half], [middle - half - 1, last])
    return Rooms.create(walls, [(0, 0, last, last)])


register_scenario(SCREENS, screens, n_walls=2, n_rooms=1, shortest_wall=lambda g: g * 11 // 30, fixed_walls=True)


def places() -> tuple[Placement, ...]:
    """Where the boxes stand at first: each in a lane of its own, none in front of another."""
    return tuple(at_placement(AGENT[0] + ahead * tan(radians(angle)), AGENT[1] - ahead) for ahead, angle in LANES)


@dataclass(frozen=True)
class PassagesConfig(Config):
    """Arguments of `ObjectCounting`."""

    speed: Positive = 2.0
    margin: Positive = 0.3
    last_start: Count = 40


@dataclass(frozen=True)
class CountingConfig(BoxesConfig):
    """Six boxes, each of which goes behind the left or the right screen; the agent cannot move.

    There is no reward: `maax-mjx bench counting` asks what the agent's memory knows. From step 65 on no box is seen.

    Attributes:
        task: arguments of the wrapper.
    """

    scenario: ScenarioNames = SCREENS
    door_size: Count = 0
    outer: Annotated[str, OneOf(OUTER)] = "none"
    n_boxes: Number = 6
    box_placement: Placements = field(default_factory=places)
    agent_placement: Placement = field(default_factory=lambda: at_placement(*AGENT))
    box_friction: NonNegativeRange | None = 0.0
    floor_friction: NonNegativeRange | None = 0.0
    # Cells into which boxes and the agent fit exactly, so that they start on their lanes.
    grid_size: GridSize = 60
    horizon: PositiveCount | None = 120
    task: PassagesConfig = field(default_factory=PassagesConfig)


def object_counting(config: CountingConfig) -> Environment:
    """Builds the counting task.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    env = ObjectCounting(one_agent(config), **arguments(config.task))
    return as_in_hide_and_seek(env, config, n_others=2, hider=False)
