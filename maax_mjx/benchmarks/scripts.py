"""How far scripted agents come in the transfer tasks: in how many worlds they solve them, in the published time.

A lock task is solved where all is done in the last step: every box is locked, and the agent is back where it has to be.
A blueprint is, where every site is filled before the end, and a shelter, where half of the rays that reach the cylinder
at first are stopped in the last step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import jax
import numpy as np

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, OneOf, PositiveCount
from maax_mjx.tasks import climbing, scenes, walking
from maax_mjx.tasks.scenes import Scene
from maax_mjx.training.evaluate import estimate

ROOMS: dict[str, dict[str, Any]] = {
    "quad": {"scenario": "quad"},
    "random": {"scenario": "random"},
    "empty": {"scenario": "empty"},
    "tri": {"scenario": "tri", "n_ramps": 3},
    "tri, anywhere": {
        "scenario": "tri", "n_ramps": 3, "agent_placement": "uniform", "box_placement": "uniform",
    },
}  # fmt: skip
"""The five kinds of rooms of `lock_all` and `lock_order`; three rooms without doors have a ramp each, to get out."""
TASKS: dict[str, Callable[[str], Scene]] = {
    "lock_and_return": scenes.lock_and_return,
    "sequential_lock": scenes.sequential_lock,
    "blueprint": scenes.blueprint,
    "shelter": scenes.shelter,
    "shelter, twice the time": partial(scenes.shelter, horizon=480),
}
LOCK_TASKS = ("lock_all", "lock_order")
NAMES = (*TASKS, *(f"{game}, {rooms}" for game in LOCK_TASKS for rooms in ROOMS))


@dataclass
class Config(Options):
    """Options.

    Attributes:
        tasks: tasks, those of locking with their rooms.
        worlds: of each.
        seed: of the worlds.
        impl: engine.
    """

    tasks: tuple[Annotated[str, OneOf(NAMES)], ...] = NAMES
    worlds: PositiveCount = 128
    seed: Count = 0
    impl: Annotated[str, OneOf(("auto", "c", "warp"))] = "auto"


@dataclass(frozen=True)
class Case:
    """One task."""

    task: str
    worlds: int
    seed: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """How far its script came; pairs are a mean and half the width of its 95 % interval.

    Attributes:
        solved: share of the worlds.
        reward: of the last step, or of that in which a world ended.
        first_reward: of the first step.
    """

    solved: tuple[float, float]
    reward: tuple[float, float]
    first_reward: tuple[float, float]


def scene_of(task: str, impl: str) -> Scene:
    """A task with the agent that plays it, up to the step before its last."""
    if task in TASKS:
        return TASKS[task](impl)
    game, rooms = task.split(", ", 1)
    options = ROOMS[rooms]
    over_walls = "n_ramps" in options
    script = climbing.sequential_lock if over_walls else walking.lock_and_return
    return scenes.alone(game, script, impl, 80, **options, **({"n_bins": None} if over_walls else {}))


def played(case: Case, impl: str) -> tuple[np.ndarray, np.ndarray]:
    """Rewards and ends (n_steps, worlds)."""
    scene = scene_of(case.task, impl)
    worlds = maax.Worlds(scene.env, case.worlds)
    first = worlds.reset(jax.random.key(case.seed))
    keep = ("reward", "terminated")
    _, kept = worlds.rollout(first, lambda state, key: scene.act(state), scene.n_steps, keep=keep)
    return np.asarray(kept["reward"])[..., 0], np.asarray(kept["terminated"])


def solved(task: str, reward: np.ndarray, ended: np.ndarray) -> np.ndarray:
    """In which worlds a task is solved: (worlds,) bool.

    Args:
        task: its name.
        reward: (n_steps, worlds).
        ended: whether a world ended with a step, the same shape.
    """
    if task == "blueprint":
        return np.asarray(ended.any(axis=0))
    if task.startswith("shelter"):
        return reward[-1] >= 0.5 * reward[0]
    # Every step in which all is done pays 1.
    return np.abs(reward[-1] - 1) < 0.05


def measure(case: Case, config: Config) -> Row:
    """Plays a task in all worlds."""
    reward, ended = played(case, config.impl)
    last = np.where(ended.any(axis=0), ended.argmax(axis=0), len(ended) - 1)
    samples = solved(case.task, reward, ended), np.take_along_axis(reward, last[None], axis=0)[0], reward[0]
    found = [estimate(np.asarray(x, float)) for x in samples]
    pairs = [(round(x.mean, 4), round(x.margin, 4)) for x in found]
    return Row(**vars(case), solved=pairs[0], reward=pairs[1], first_reward=pairs[2])


def cases(config: Config) -> Iterator[Case]:
    """Cases."""
    for task in config.tasks:
        yield Case(task, config.worlds, config.seed)


HEADER = f"{'task':28}{'worlds':>8}{'solved':>16}{'last reward':>18}{'first':>18}"


def line(row: Row) -> str:
    """A row of the table."""
    pairs = (row.reward, row.first_reward)
    cells = "".join(f"{mean:9.3f} ± {margin:5.3f}" for mean, margin in pairs)
    return f"{row.task:28}{row.worlds:8,}{row.solved[0]:9.3f} ± {row.solved[1]:5.3f}{cells}"


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
