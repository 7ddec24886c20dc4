"""Shelter construction, by the published code (`envs/shelter_construction.py:25-71`: the reward, 78: its rays)."""

from __future__ import annotations

from dataclasses import dataclass, field

from maax_mjx.common.annotated import NonNegative, NonNegativeRange, Positive, PositiveCount, PositiveRange
from maax_mjx.core.env import Environment
from maax_mjx.layout import published_middle_placement
from maax_mjx.modules import StaticCylinders
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.hide_and_seek import arguments
from maax_mjx.tasks.standard import Number
from maax_mjx.tasks.transfer.blueprint import Share
from maax_mjx.tasks.transfer.common import BoxesConfig, as_in_hide_and_seek, one_agent
from maax_mjx.wrappers import SelectObservations, ShelterReward


@dataclass(frozen=True)
class ShelterRewardConfig(Config):
    """Arguments of `ShelterReward`."""

    rays_per_side: PositiveCount = 25
    scale: NonNegative = 0.001


@dataclass(frozen=True)
class ShelterConfig(BoxesConfig):
    """`shelter.jsonnet`: eight boxes, three of them elongated, to be put around a cylinder that stands fast.

    MJX's own physics (`impl="jax"`) has no contacts between a cylinder and a box: this takes `c` or `warp`.

    Attributes:
        cylinder_diameter: metres, or a range.
        cylinder_height: metres.
        cylinder_middle: how near to the middle it stands; see `published_middle_placement`.
        sees_cylinder: whether its place and size are observed; in the published task only the lidar tells of it.
        task: arguments of the reward.
    """

    n_boxes: Number = 8
    n_elongated_boxes: Number = 3
    cylinder_diameter: PositiveRange = (1.5, 2.0)
    cylinder_height: Positive = 0.5
    cylinder_middle: Share = 0.7
    sees_cylinder: bool = False
    wall_friction: NonNegativeRange | None = 0.01
    horizon: PositiveCount | None = 240
    task: ShelterRewardConfig = field(default_factory=ShelterRewardConfig)


def shelter(config: ShelterConfig) -> Environment:
    """Builds the shelter task.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    cylinder = StaticCylinders(
        1, config.cylinder_diameter, config.cylinder_height, published_middle_placement(config.cylinder_middle)
    )
    env: Environment = ShelterReward(one_agent(config, first=(cylinder,)), **arguments(config.task))
    if not config.sees_cylinder:
        env = SelectObservations(env, [name for name in env.observed if name not in cylinder.declared()])
    return as_in_hide_and_seek(env, config, n_others=2, hider=False)
