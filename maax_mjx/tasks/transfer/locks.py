"""Lock and return, and sequential lock: boxes to be locked, by the published code (`envs/box_locking.py`)."""

from __future__ import annotations

from dataclasses import dataclass, field

from maax_mjx.common.annotated import Count, NonNegative, NonNegativeRange, Positive, PositiveCount, PositiveCountRange
from maax_mjx.core.env import Environment
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.hide_and_seek import GrabConfig, LockConfig, arguments
from maax_mjx.tasks.standard import Number, Placements, ScenarioNames
from maax_mjx.tasks.transfer.common import TransferConfig, as_in_hide_and_seek, one_agent
from maax_mjx.wrappers import LockInOrder, LockTask


@dataclass(frozen=True)
class LockTaskConfig(Config):
    """Arguments of `LockTask`; with `in_order`, later boxes cannot be locked before earlier ones (`LockInOrder`)."""

    in_order: bool = False
    and_return: bool = False
    lock: NonNegative = 5.0
    unlock: NonNegative = 5.0
    shaped: NonNegative = 0.5
    success: NonNegative = 1.0
    radius: Positive = 0.1
    from_corners: bool = True


@dataclass(frozen=True)
class LockAndReturnConfig(TransferConfig):
    """`lock_and_return.jsonnet`: find the box in one of six rooms, lock it, and come back.

    Attributes:
        task: arguments of the reward.
    """

    scenario: ScenarioNames = "random"
    n_rooms: PositiveCountRange = 6
    n_boxes: Number = 1
    n_ramps: Number = 0
    wall_friction: NonNegativeRange | None = None
    horizon: PositiveCount = 120
    lock: LockConfig = field(default_factory=lambda: LockConfig(objects=("box",), in_vision_only=True))
    grab: GrabConfig | None = field(default_factory=lambda: GrabConfig(objects=("box",), in_vision_only=True))
    task: LockTaskConfig = LockTaskConfig(and_return=True)


@dataclass(frozen=True)
class SequentialLockConfig(TransferConfig):
    """`sequential_lock.jsonnet`: four boxes to be locked in an order that is not observed.

    They and the agent are anywhere in three rooms without doors; a ramp in each leads over its walls.

    Attributes:
        task: arguments of the reward.
    """

    scenario: ScenarioNames = "tri"
    door_size: Count = 0
    n_boxes: Number = 4
    n_ramps: Number = 3
    ramp_placement: Placements = ("room0", "room1", "room2")
    wall_friction: NonNegativeRange | None = None
    horizon: PositiveCount = 120
    task: LockTaskConfig = LockTaskConfig(in_order=True)


def lock_task(config: LockAndReturnConfig | SequentialLockConfig) -> Environment:
    """Builds a lock task.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    env: Environment = LockTask(one_agent(config), **arguments(config.task))
    if config.task.in_order:
        env = LockInOrder(env)
    return as_in_hide_and_seek(env, config)
