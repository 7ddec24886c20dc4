"""Food in games of hide and seek, and who may eat it (Baker et al.)."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Annotated

import jax
import jax.numpy as jnp

from maax_mjx.common.annotated import NonNegativeRange, OneOf, Positive, PositiveCount
from maax_mjx.core.env import Environment
from maax_mjx.layout import (
    Layout,
    published_middle_placement,
    published_proximity_placement,
    published_quad_placement,
)
from maax_mjx.modules import Food
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.standard import Placement, placement_of
from maax_mjx.wrappers import (
    AlwaysEat,
    EatFood,
    MaskActions,
    MaskPreparationAction,
    MaskUnseenAction,
)
from maax_mjx.wrappers.food import EAT, FOOD_REW_TYPES
from maax_mjx.wrappers.senses import BETWEEN
from maax_mjx.wrappers.teams import HIDERS

MIDDLE = 0.25
"""Share of the floor's edge, of the square in which the first piece of food lies."""


@dataclass(frozen=True)
class FoodConfig(Config):
    """Food that hiders eat while no seeker sees a hider, after preparation, and arguments of `EatFood`.

    Attributes:
        n_food: pieces in every world.
        n_clusters: groups that they lie in; `n_food` is a multiple of it.
        placement: where the first piece of every group lies; None is the quadrant in worlds with one, else the middle
            of the floor, as published.
        together_radius: metres from the first piece of a group to the others, on each axis, see
            `published_proximity_placement`; None places all like the first.
        when_caught: whether hiders can eat while a seeker sees one of them, too.
        radius: see `EatFood`.
        max_health: see `EatFood`.
        respawn_steps: see `EatFood`.
        rew_type: see `EatFood`.
        scale: see `EatFood`.
        split: see `EatFood`.
        observe_scale: see `EatFood`.
        between: see `EatFood`.
    """

    n_food: PositiveCount = 4
    n_clusters: PositiveCount = 1
    placement: Placement | None = None
    together_radius: Positive | None = 0.25
    when_caught: bool = False
    radius: Positive = 0.5
    max_health: PositiveCount = 40
    respawn_steps: PositiveCount | None = 5
    rew_type: Annotated[str, OneOf(FOOD_REW_TYPES)] = "team_mean"
    scale: NonNegativeRange = 1.0
    split: bool = False
    observe_scale: bool = False
    between: Annotated[str, OneOf(BETWEEN)] = "centres"


def food_of(config: FoodConfig, cell: float) -> Food:
    """Makes the food of a config: the first piece of each group, and the others near it.

    Args:
        config: the config.
        cell: edge of the grid's cells in metres, on the largest floor.

    Raises:
        ValueError: groups of different sizes, or larger than their place.
    """
    n, each = config.n_food, config.n_food // config.n_clusters
    if n % config.n_clusters:
        raise ValueError(
            f"food.n_clusters: got {config.n_clusters} for n_food={n}; takes a number of groups that are equally large"
        )
    first = _first_piece if config.placement is None else placement_of("food.placement", config.placement)
    placements = [first] * n
    if config.together_radius is not None:
        radius, firsts = config.together_radius, [f"{Food.kind}{i // each * each}" for i in range(n)]
        room = (2 * ceil(radius / cell - 1e-6)) ** 2
        if each > room:
            raise ValueError(
                f"food.n_food: got {each} pieces in a group with together_radius={radius:g}, which has {room} cells; "
                "takes fewer, more groups (n_clusters), or a larger radius"
            )
        placements = [published_proximity_placement(radius, firsts[i]) if i % each else first for i in range(n)]
    return Food(n, placement_fn=placements)


def _first_piece(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows places in the quadrant, or around the middle of a floor without one, as published."""
    middle = published_middle_placement(MIDDLE)(layout, cells)
    return jnp.where(layout.plan.quadrant[2] > 0, published_quad_placement(layout, cells), middle)


def with_food(env: Environment, config: FoodConfig) -> Environment:
    """Lets hiders eat what they see, by the published rules."""
    env = EatFood(
        env, config.radius, config.max_health, config.respawn_steps, config.rew_type, config.scale,
        config.split, config.observe_scale, config.between,
    )  # fmt: skip
    env = MaskPreparationAction(MaskActions(env, EAT, (f"sees_{Food.kind}",)), EAT)
    if not config.when_caught:
        env = MaskUnseenAction(env, EAT)
    return AlwaysEat(env, HIDERS)
