"""Curves of runs beside one another, read from their metrics: what a setting was worth, with equal samples.

A run is LABEL=FOLDER, or LABEL=FOLDER+FOLDER where one went on from another; runs of one label differ in their seeds
alone, and have one colour in the picture.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.training.folder import Folder, is_run
from maax_mjx.training.learner import counted_by

CHASE = 0.85
"""Share of the steps in which hiders are caught from which seekers are said to chase; see training/stages.py."""
CAUGHT = "episode_caught"
WHOLE = "whole"


@dataclass
class Config(Options):
    """Options.

    Attributes:
        runs: LABEL=FOLDER, or LABEL=FOLDER+FOLDER.
        numbers: of the metrics.
        steps: env steps up to which runs are read; None reads them whole.
        every: env steps of a point.
    """

    runs: tuple[str, ...] = ()
    numbers: tuple[str, ...] = (CAUGHT, "episode_boxes_locked_prep", "episode_max_box_move_prep")
    steps: PositiveCount | None = None
    every: PositiveCount = 2_000_000

    def check(self) -> None:
        super().check()
        if not self.runs:
            raise ValueError("runs: got none; takes LABEL=FOLDER or LABEL=FOLDER+FOLDER, folders of runs")
        for run in self.runs:
            label, _, folders = run.partition("=")
            for path in map(Path, folders.split("+")):
                if not label or not is_run(path):
                    raise ValueError(
                        f"runs: got {run!r}; takes LABEL=FOLDER or LABEL=FOLDER+FOLDER of runs that there are"
                    )


@dataclass(frozen=True)
class Case:
    """One run, perhaps of several pieces."""

    run: str
    folders: str
    every: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """What its metrics say.

    Attributes:
        steps: env steps that were read.
        minutes: of training up to there, compilation not included.
        chase: env steps after which hiders were first caught in 0.85 of the steps; None if they were not.
        devices: of the training.
        curves: of every number, env steps and the mean over the episodes that ended since the point before. Left out
            are iterations of a piece before as many episodes ended as there are worlds: it begins with short ones.
    """

    steps: int
    minutes: float
    chase: int | None
    devices: list[str]
    curves: dict[str, list[tuple[int, float]]]


def cases(config: Config) -> Iterator[Case]:
    """Cases, in the order of the options."""
    for run in config.runs:
        label, _, folders = run.partition("=")
        yield Case(label, folders, config.every)


def measure(case: Case, config: Config) -> Row:
    """Reads a run.

    Raises:
        ValueError: a number that its metrics lack.
    """
    folders = [Folder(path) for path in case.folders.split("+")]
    rows = joined([marked(folder.rows(), folder.about()["settings"]["worlds"]) for folder in folders])
    rows = [row for row in rows if row["steps"] <= (config.steps or np.inf)]
    ended = [row for row in rows if row["episodes"]]
    whole = [row for row in ended if row[WHOLE]]
    for name in config.numbers:
        if not whole or name not in whole[-1]:
            raise ValueError(f"numbers: got {name!r}, which {case.folders} lacks; takes names of its metrics")
    return Row(
        **vars(case),
        steps=rows[-1]["steps"],
        minutes=round(rows[-1]["seconds"] / 60, 2),
        chase=next((row["steps"] for row in ended if (row.get(CAUGHT) or 0) >= CHASE), None),
        devices=sorted({name for folder in folders for name in folder.about()["conditions"]["devices"]}),
        curves={name: curve_of(whole, name, case.every) for name in config.numbers},
    )


def marked(rows: Sequence[dict[str, Any]], worlds: int) -> list[dict[str, Any]]:
    """The rows of a piece, each with whether so many episodes had ended before it."""
    before = np.cumsum([0, *(row["episodes"] for row in rows)])
    return [row | {WHOLE: bool(n >= worlds)} for row, n in zip(rows, before[:-1], strict=True)]


def joined(pieces: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
    """The rows of pieces that went on from one another, with the steps and seconds of those before added."""
    rows: list[dict[str, Any]] = []
    for piece in pieces:
        before = rows[-1] if rows else {"steps": 0, "seconds": 0.0}
        rows += [row | {name: row[name] + before[name] for name in ("steps", "seconds")} for row in piece]
    return rows


def curve_of(rows: Sequence[dict[str, Any]], name: str, every: int) -> list[tuple[int, float]]:
    """The mean over the episodes of every so many steps, at the last step of each."""
    points = []
    for part in sorted({-(-row["steps"] // every) for row in rows}):
        inside = [row for row in rows if -(-row["steps"] // every) == part and row[name] is not None]
        if not inside:
            continue
        counts = [row.get(counted_by(name), row["episodes"]) for row in inside]  # older runs count all together
        mean = np.average([row[name] for row in inside], weights=counts)
        points.append((inside[-1]["steps"], round(float(mean), 4)))
    return points


HEADER = "run                          steps   minutes   chase after   then"


def line(row: Row) -> str:
    """A row of the table."""
    ends = {name.removeprefix("episode_"): curve[-1][1] for name, curve in row.curves.items() if curve}
    last = ", ".join(f"{name} {x:.3f}" for name, x in ends.items())
    chase = "never" if row.chase is None else f"{row.chase:,}"
    return f"{row.run[:20]:20} {row.steps:13,} {row.minutes:9.1f} {chase:>13}   {last}"


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
