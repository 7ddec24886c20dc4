"""Complete games and their configs, and environments by name."""

from maax_mjx.tasks.brought import is_in_a_file, short_name
from maax_mjx.tasks.capture_the_flag import CaptureTheFlagConfig, capture_the_flag
from maax_mjx.tasks.food import FoodConfig
from maax_mjx.tasks.hide_and_seek import (
    FoodGameConfig,
    FullConfig,
    GrabConfig,
    HideAndSeekConfig,
    LidarConfig,
    LockConfig,
    QuadrantConfig,
    RectConfig,
    hide_and_seek,
)
from maax_mjx.tasks.observe import observed_by_agents
from maax_mjx.tasks.registry import check_game, config_of, jitted, make, register, tasks
from maax_mjx.tasks.standard import GameConfig, StandardConfig, WorldConfig, standard, world
from maax_mjx.tasks.tag import TagConfig, tag
from maax_mjx.tasks.transfer.blueprint import BlueprintConfig, blueprint
from maax_mjx.tasks.transfer.counting import CountingConfig, object_counting
from maax_mjx.tasks.transfer.locks import (
    LockAllConfig,
    LockAndReturnConfig,
    LockOrderConfig,
    LockTaskConfig,
    SequentialLockConfig,
    lock_all,
    lock_task,
    sequential_lock,
)
from maax_mjx.tasks.transfer.shelter import ShelterConfig, shelter

register("standard", standard, StandardConfig)
register("hide_and_seek", hide_and_seek, HideAndSeekConfig)
register("hide_and_seek_quadrant", hide_and_seek, QuadrantConfig)
register("hide_and_seek_full", hide_and_seek, FullConfig)
register("hide_and_seek_food", hide_and_seek, FoodGameConfig)
register("tag", tag, TagConfig)
register("capture_the_flag", capture_the_flag, CaptureTheFlagConfig)
register("blueprint", blueprint, BlueprintConfig)
register("lock_all", lock_all, LockAllConfig)
register("lock_and_return", lock_task, LockAndReturnConfig)
register("lock_order", lock_all, LockOrderConfig)
register("object_counting", object_counting, CountingConfig)
register("sequential_lock", sequential_lock, SequentialLockConfig)
register("shelter", shelter, ShelterConfig)

__all__ = [
    "BlueprintConfig",
    "CaptureTheFlagConfig",
    "CountingConfig",
    "FoodConfig",
    "FoodGameConfig",
    "FullConfig",
    "GameConfig",
    "GrabConfig",
    "HideAndSeekConfig",
    "LidarConfig",
    "LockAllConfig",
    "LockAndReturnConfig",
    "LockConfig",
    "LockOrderConfig",
    "LockTaskConfig",
    "QuadrantConfig",
    "RectConfig",
    "SequentialLockConfig",
    "ShelterConfig",
    "StandardConfig",
    "TagConfig",
    "WorldConfig",
    "blueprint",
    "capture_the_flag",
    "check_game",
    "config_of",
    "hide_and_seek",
    "is_in_a_file",
    "jitted",
    "lock_all",
    "lock_task",
    "make",
    "object_counting",
    "observed_by_agents",
    "register",
    "sequential_lock",
    "shelter",
    "short_name",
    "standard",
    "tag",
    "tasks",
    "world",
]
