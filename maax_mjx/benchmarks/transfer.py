"""What a policy of hide-and-seek is worth in other tasks: learning begun from it, beside learning from scratch.

As in Baker et al.'s transfer tasks: both have the same networks, settings and samples; what was learnt is taken over
by names, and the last layers and the norms before them are drawn anew (`train --transfer`). Curves are the mean return
of the episodes that ended in an iteration. Runs stay in `--runs`, go on where they were, and one that has all its steps
is only read: several processes or machines can train them, and one write the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from maax_mjx import training
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, Positive, PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.training.folder import Folder
from maax_mjx.training.learner import counted_by

SCRATCH = "scratch"
POINTS = 60
"""Points of a curve, each the mean of the iterations around it."""
LAST = 0.1
"""Share of the steps, at the end, whose episodes make the final return."""
RETURN = "return_hiders"


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: tasks of one agent, by name.
        begin: what runs begin with: "scratch", or policies of `training.policies()` or their files.
        seeds: of the runs.
        steps: env steps of each run.
        worlds: of each run.
        minibatches: of an iteration.
        gamma: discount for an env step.
        preset: the other settings.
        minutes: of training at most, for each run, compilation not included; one that has not made all its steps then
            goes on in a later run of this benchmark.
        runs: folder for the runs.
    """

    env: tuple[str, ...] = ("lock_and_return", "sequential_lock", "blueprint", "shelter")
    begin: tuple[str, ...] = (SCRATCH, "quadrant/ramps")
    seeds: tuple[Count, ...] = (0, 1, 2)
    steps: PositiveCount = 8_000_000
    worlds: PositiveCount = 4096
    minibatches: PositiveCount = 4
    gamma: Positive = 0.99
    preset: str = "gpu"
    minutes: Positive | None = None
    runs: Path = Path("runs") / "transfer"

    def check(self) -> None:
        super().check()
        check_choice("preset", self.preset, training.PRESETS)


@dataclass(frozen=True)
class Case:
    """One run."""

    env: str
    begin: str
    seed: int
    steps: int
    worlds: int
    gamma: float


@dataclass(frozen=True)
class Row(Case, Measured):
    """What a run learnt.

    Attributes:
        final: mean return of the episodes of the last tenth of the steps.
        curve: env steps and mean returns.
        minutes: of training, compilation not included.
        devices: of the training.
        faults: physics faults per million env steps.
    """

    final: float
    curve: list[tuple[float, float]]
    minutes: float
    devices: list[str]
    faults: float


def cases(config: Config) -> Iterator[Case]:
    """Cases, all tasks with one seed before the next seed."""
    for seed, env, begin in product(config.seeds, config.env, config.begin):
        yield Case(env, begin, seed, config.steps, config.worlds, config.gamma)


def folder_of(case: Case, config: Config) -> Path:
    """Where a run is."""
    return config.runs / f"{case.env}_{case.begin.replace('/', '-')}_{case.seed}"


def measure(case: Case, config: Config) -> Row:
    """Trains a run, as far as it is not trained yet, and reads what it learnt.

    Raises:
        ValueError: a folder with a run of other settings, or a game without hiders.
        RuntimeError: the minutes are over before the steps.
    """
    path = folder_of(case, config)
    if steps_of(path) < case.steps:
        train(case, config, path)
    folder = Folder(path)
    about, rows = folder.about(), folder.rows()
    check_settings(about, case, config)
    if RETURN not in rows[-1]:
        raise ValueError(f"env: got {case.env!r}, whose runs have no {RETURN}; takes games with hiders")
    if rows[-1]["steps"] < case.steps:
        raise RuntimeError(f"{path}: has {rows[-1]['steps']:,} of {case.steps:,} steps; run again to go on")
    end = next(row["steps"] for row in rows if row["steps"] >= case.steps)
    rows = [row for row in rows if row["steps"] <= end]
    points = returns_of(rows)
    late = [(x, y, n) for x, y, n in points if x > (1 - LAST) * rows[-1]["steps"]]
    return Row(
        **vars(case),
        final=round(weighted(late), 4),
        curve=curve_of(points),
        minutes=round(rows[-1]["seconds"] / 60, 2),
        devices=about["conditions"]["devices"],
        faults=round(1e6 * sum(row["faults"] for row in rows) / rows[-1]["steps"], 2),
    )


def check_settings(about: dict[str, Any], case: Case, config: Config) -> None:
    """Refuses a run that was trained with other settings than its row would say.

    Raises:
        ValueError: naming the setting.
    """
    settings = about["settings"]
    wanted = {"worlds": case.worlds, "gamma": case.gamma, "minibatches": config.minibatches, "preset": config.preset}
    found = {
        "worlds": settings["worlds"],
        "gamma": settings["ppo"]["gamma"],
        "minibatches": settings["ppo"]["minibatches"],
        "preset": about["preset"],
    }
    for name, value in wanted.items():
        if found[name] != value:
            raise ValueError(
                f"{name}: got {value}, and {folder_of(case, config)} has a run with {found[name]}; takes the same, or "
                "another folder in --runs"
            )


def train(case: Case, config: Config, path: Path) -> None:
    """Trains a run up to its steps, or until its minutes are over."""
    scratch = case.begin == SCRATCH
    settings: dict[str, Any] = {"ppo.minibatches": config.minibatches, "ppo.gamma": case.gamma, "save_worlds": False}
    trainer = training.Trainer(
        case.env,
        path,
        config.preset,
        worlds=case.worlds,
        seed=case.seed,
        begin_from=None if scratch else training.Policy.load(case.begin),
        transfer=not scratch,
        **settings,
    )
    with training.Bar(config.minutes, case.steps) as bar:
        trainer.run(config.minutes, case.steps, bar.of(trainer))


def steps_of(path: Path) -> int:
    """Env steps of a run so far."""
    rows = Folder(path).rows() if path.is_dir() else []
    return rows[-1]["steps"] if rows else 0


Points = Sequence[tuple[float, float, float]]
"""Env steps, mean return, and of how many episodes."""


def returns_of(rows: Sequence[dict[str, Any]]) -> Points:
    """Returns of the iterations in which episodes ended that count."""
    counted = [row for row in rows if row["episodes"] and row[RETURN] is not None]
    return [(row["steps"], row[RETURN], row.get(counted_by(RETURN), row["episodes"])) for row in counted]


def weighted(points: Points | np.ndarray) -> float:
    """Mean return over all episodes."""
    x = np.asarray(points, float).reshape(-1, 3)
    return float((x[:, 1] * x[:, 2]).sum() / x[:, 2].sum())


def curve_of(points: Points) -> list[tuple[float, float]]:
    """At most so many points, each of as many iterations."""
    groups = np.array_split(np.asarray(points, float), min(len(points), POINTS))
    return [(round(float(group[-1, 0])), round(weighted(group), 4)) for group in groups]


HEADER = "env              begin             seed      steps   minutes   final return   faults/M"


def line(row: Row) -> str:
    """A row of the table."""
    return (
        f"{row.env:16} {row.begin[-16:]:16} {row.seed:5} {row.steps:10,} {row.minutes:9.1f} {row.final:14.3f} "
        f"{row.faults:10.2f}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
