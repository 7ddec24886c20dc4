"""The lock tasks: boxes to be locked, by the published code.

Rewards are `LockObjectsTask`'s (`envs/box_locking.py:24-185`), rooms and places those of its `make_env` (252-384) and,
for three rooms, of `modules/walls.py:409-461`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from maax_mjx.common.annotated import Count, NonNegative, NonNegativeRange, Positive, PositiveCount, PositiveCountRange
from maax_mjx.common.checks import check_count_range
from maax_mjx.core.env import Environment
from maax_mjx.tasks.config import Config
from maax_mjx.tasks.hide_and_seek import LidarConfig, LockConfig, arguments
from maax_mjx.tasks.standard import Number, Placement, Placements, ScenarioNames
from maax_mjx.tasks.transfer.common import BoxesConfig, TransferConfig, as_in_hide_and_seek, one_agent
from maax_mjx.wrappers import LockInOrder, LockTask

N_ROOMS = 3
"""Of the scenario "tri"."""


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
class LockAndReturnConfig(BoxesConfig):
    """`lock_and_return.jsonnet`: find the box in one of six rooms, lock it, and come back.

    Attributes:
        task: arguments of the reward.
    """

    scenario: ScenarioNames = "random"
    n_rooms: PositiveCountRange = 6
    n_boxes: Number = 1
    wall_friction: NonNegativeRange | None = None
    horizon: PositiveCount | None = 120
    task: LockTaskConfig = LockTaskConfig(and_return=True)


@dataclass(frozen=True)
class SequentialLockConfig(TransferConfig):
    """`sequential_lock.jsonnet`: four boxes to be locked in an order that is not observed.

    They and the agent are anywhere in three rooms without doors; a ramp in each leads over its walls.

    Attributes:
        ramp_placement: None is as published, the first ramp in the first room, and so on; in other rooms anywhere.
        task: arguments of the reward.
    """

    scenario: ScenarioNames = "tri"
    door_size: Count = 0
    n_boxes: Number = 4
    n_ramps: Number = 3
    ramp_placement: Placements | None = None  # type: ignore[assignment]
    wall_friction: NonNegativeRange | None = None
    horizon: PositiveCount | None = 120
    task: LockTaskConfig = LockTaskConfig(in_order=True)

    def completed(self) -> SequentialLockConfig:
        """The same with what was published in place of None."""
        published = _one_in_each_room(self.n_ramps) if _only(self.scenario) == "tri" else "uniform"
        return replace(self, ramp_placement=published if self.ramp_placement is None else self.ramp_placement)


@dataclass(frozen=True)
class LockAllConfig(TransferConfig):
    """Two boxes to be locked, with what the published code takes where no config says anything.

    Two things differ: boxes turn about z alone, as in all published configs (the code's own default lets them tip), and
    their numbers are not observed.

    The published scenarios are "quad", "random", "empty" and "tri", with the
    placements below, and "tri" with `agent_placement="uniform"` and `box_placement="uniform"`. Where several are drawn
    from, all is anywhere.

    Attributes:
        agent_placement: where the agent starts; None is as published: in the quadrant, in the centre of an empty floor,
            in any of three rooms, else anywhere.
        box_placement, ramp_placement: None is as published: in three rooms, boxes in those with fewest objects, and a
            ramp in each; else anywhere.
        wall_friction: None is as published: 0.01 around a quadrant, else MuJoCo's default of 1.
        task: arguments of the reward.
    """

    scenario: ScenarioNames = "quad"
    n_rooms: PositiveCountRange = (1, 4)
    agent_placement: Placement | None = None  # type: ignore[assignment]
    box_placement: Placements | None = None  # type: ignore[assignment]
    ramp_placement: Placements | None = None  # type: ignore[assignment]
    n_boxes: Number = 2
    n_ramps: Number = 0
    wall_friction: NonNegativeRange | None = None
    horizon: PositiveCount | None = 80
    lock: LockConfig = field(default_factory=lambda: LockConfig(lock_type="any_specific"))
    lidar: LidarConfig | None = None
    task: LockTaskConfig = LockTaskConfig(unlock=7.0, shaped=0.25)

    def completed(self) -> LockAllConfig:
        """The same with what was published in place of None."""
        found: dict[str, dict[str, Any]] = {
            "quad": {"agent_placement": "quad", "wall_friction": 0.01},
            "empty": {"agent_placement": "centre"},
            "tri": {
                "agent_placement": "rooms_in_turn",
                "box_placement": "rooms_in_turn",
                "ramp_placement": _one_in_each_room(self.n_ramps),
            },
        }
        anywhere = dict.fromkeys(("agent_placement", "box_placement", "ramp_placement"), "uniform")
        chosen = anywhere | found.get(_only(self.scenario), {})
        return replace(self, **{name: value for name, value in chosen.items() if getattr(self, name) is None})


@dataclass(frozen=True)
class LockOrderConfig(LockAllConfig):
    """The same, in the order of the boxes' numbers; see `LockAllConfig`."""

    task: LockTaskConfig = LockTaskConfig(in_order=True, unlock=7.0, shaped=0.25)


def sequential_lock(config: SequentialLockConfig) -> Environment:
    """Builds the game of `SequentialLockConfig`.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    return lock_task(config.completed())


def lock_all(config: LockAllConfig) -> Environment:
    """Builds the game of `LockAllConfig`.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    return lock_task(config.completed())


def lock_task(config: LockAndReturnConfig | SequentialLockConfig | LockAllConfig) -> Environment:
    """Builds a lock task.

    Raises:
        ValueError: a config that the world or the wrappers refuse.
    """
    if not check_count_range("n_boxes", config.n_boxes)[0]:
        raise ValueError(f"n_boxes: got {config.n_boxes}; a lock task takes at least one box to lock in every world")
    if config.lock is not None and "box" not in config.lock.objects:
        raise ValueError(f"lock.objects: got {config.lock.objects}; a lock task takes 'box' among them, to be locked")
    env: Environment = LockTask(one_agent(config), **arguments(config.task))
    if config.task.in_order:
        env = LockInOrder(env)
    return as_in_hide_and_seek(env, config)


def _only(scenario: ScenarioNames) -> str:
    """Returns the scenario of all worlds; "" where several are drawn from."""
    names = (scenario,) if isinstance(scenario, str) else scenario
    return names[0] if len(names) == 1 else ""


def _one_in_each_room(n_ramps: Number) -> list[Placement] | Placement:
    return [f"room{i % N_ROOMS}" for i in range(check_count_range("n_ramps", n_ramps)[1])] or "uniform"
