"""Construction from a blueprint, by the published code.

The rewards are of `envs/blueprint_construction.py:53-124`, the sites of `modules/construction_sites.py:38-111`, their
places of `modules/util.py:96-122`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from maax_mjx.common.annotated import Bounds, NonNegative, NonNegativeRange, Positive, PositiveCount
from maax_mjx.common.checks import check_count_range, check_range
from maax_mjx.core.env import Environment
from maax_mjx.layout import published_middle_placement
from maax_mjx.layout.grid import footprint_of
from maax_mjx.layout.placement import region_of
from maax_mjx.modules import ConstructionSites
from maax_mjx.modules.placed import MOST
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.hide_and_seek import arguments
from maax_mjx.tasks.standard import Number
from maax_mjx.tasks.transfer.common import BoxesConfig, as_in_hide_and_seek, one_agent
from maax_mjx.wrappers import BlueprintReward
from maax_mjx.wrappers.blueprint import Steepness

SITE = 0.5
"""Metres, the edge of a site."""

Share = Annotated[float, Bounds(0, 1, above=True)]
Sites = Annotated[int | tuple[int, int], Bounds(1, MOST)]


@dataclass(frozen=True)
class BlueprintRewardConfig(Config):
    """Arguments of `BlueprintReward`."""

    scale: NonNegative = 0.05
    steepness: Steepness = -1.5
    completed: NonNegative = 3.0
    radius: Positive = 0.1


@dataclass(frozen=True)
class BlueprintConfig(BoxesConfig):
    """`blueprint.jsonnet`: eight boxes, of which some are to be brought to 1 to 4 sites; then the episode ends.

    Attributes:
        n_sites: construction sites of a world, or (low, high).
        site_middle: how near to the middle they are; see `published_middle_placement`.
        task: arguments of the reward.
    """

    n_boxes: Number = 8
    n_sites: Sites = (1, 4)
    site_middle: Share = 0.85
    wall_friction: NonNegativeRange | None = 0.01
    horizon: PositiveCount | None = 150
    task: BlueprintRewardConfig = field(default_factory=BlueprintRewardConfig)


def blueprint(config: BlueprintConfig) -> Environment:
    """Builds the blueprint task.

    Raises:
        ValueError: more sites than boxes or places, or a config that the world or the wrappers refuse.
    """
    most_sites, most_boxes = (check_count_range(n, getattr(config, n))[1] for n in ("n_sites", "n_boxes"))
    if most_sites > most_boxes:
        raise ValueError(f"n_sites: got {config.n_sites} with {most_boxes} boxes to fill them; takes as many at most")
    sites = ConstructionSites(config.n_sites, SITE, placement_fn=published_middle_placement(config.site_middle))
    fitting = _fitting(config, sites)
    if fitting < most_sites:
        raise ValueError(
            f"n_sites: got {config.n_sites} with site_middle={config.site_middle:g}, where {fitting} fit beside each "
            "other; takes as many at most, or sites further from the middle"
        )
    env = BlueprintReward(one_agent(config, sites), **arguments(config.task))
    return as_in_hide_and_seek(env, config, n_others=2, hider=False)


def _fitting(config: BlueprintConfig, sites: ConstructionSites) -> int:
    """How many sites fit beside each other where they may be, at most."""
    edge = check_range("floor_size", config.floor_size, above=True)[1]
    cell = edge / config.grid_size
    cells = np.array(footprint_of((SITE, SITE), cell))
    region = region_of(sites.placement_fns[0])
    assert region is not None
    low, high = region(config.grid_size, cell, cells)
    return int(np.prod(np.maximum(high - low, 0) // cells))
