"""What the policies of a run do with tools, at every stage of it, and what is left of that with something taken away.

Each policy plays itself: as it is, and under each of `training.INTERVENTIONS` that is asked for. A stage is named where
all its numbers are within the bounds of `training/stages.py`, which were set before any long run. `minutes`, `episodes`
and `devices` are those of the training up to the policy, from the run's metrics.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from maax_mjx import training
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import OneOf, PositiveCount
from maax_mjx.common.options import value_of
from maax_mjx.training.folder import Folder
from maax_mjx.training.stages import stage_reached
from maax_mjx.wrappers.teams import SEEKERS

NOTHING, RANDOM = "nothing", "random"
NUMBERS = (
    "seen",
    "enclosed_prep",
    "enclosed",
    "doors_blocked_prep",
    "boxes_locked_prep",
    "max_box_move_prep",
    "max_ramp_move_prep",
    "ramp_inside_prep",
    "seekers_carried_ramp",
    "elevated",
    "breach",
)
"""Of `TrackStats` and `TrackTools`; those that a game does not count are left out."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        runs: folders of runs.
        without: what is taken away, one thing at a time, or "nothing".
        against: who plays the hiders: the policy itself, or random actions.
        change: fields of the game's config with other values than it was learnt with, such as p_door_dropout=1.
        episodes: of each match.
        past: whether past policies of the runs are played, or the newest alone.
        impl: engine.
    """

    runs: tuple[Path, ...] = (Path("runs") / "hide_and_seek_quadrant",)
    without: tuple[Annotated[str, OneOf((NOTHING, *training.INTERVENTIONS))], ...] = (
        NOTHING,
        *training.INTERVENTIONS,
    )
    against: tuple[Annotated[str, OneOf(("self", RANDOM))], ...] = ("self",)
    change: tuple[str, ...] = ()
    episodes: PositiveCount = 1024
    past: bool = True
    impl: Impl = "auto"

    def check(self) -> None:
        super().check()
        names = [folder.name for folder in self.runs]
        if len(set(names)) < len(names):
            raise ValueError(f"runs: got {names}; takes folders of different names, by which rows are told apart")
        for text in self.change:
            name, _, value = text.partition("=")
            if not value or not all(part.isidentifier() for part in name.split(".")):
                raise ValueError(f"change: got {text!r}; takes a field and its value, such as p_door_dropout=1")


@dataclass(frozen=True)
class Case:
    """One match.

    Attributes:
        run: name of the run's folder.
        steps: env steps of training.
        without: what was taken away, or "nothing".
        against: who plays the hiders.
        changed: fields of the game's config that have other values than it was learnt with.
    """

    run: str
    steps: int
    without: str
    against: str
    changed: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Row(Case, Measured):
    """What was done in a match.

    Attributes:
        minutes: of training, compilation not included.
        trained: episodes of training.
        devices: of the training.
        episodes: of the match.
        stage: the furthest stage whose bounds hold, "" for none.
        numbers: the game's numbers by name, each a mean and half the width of its 95 % interval.
    """

    minutes: float
    trained: int
    devices: list[str]
    episodes: int
    stage: str
    numbers: dict[str, tuple[float, float]]


def files_of(folder: Path, past: bool) -> list[tuple[int, Path]]:
    """Returns steps and files of a run's policies, the newest last."""
    newest = training.Policy.load(folder)
    found = [one for one in Folder(folder).past() if 0 < one[0] < newest.steps] if past else []
    return [*found, (newest.steps, folder / "policy")]


def cases(config: Config) -> Iterator[Case]:
    """Cases, all that is taken away from one policy before the next."""
    for folder in config.runs:
        for steps, _ in files_of(folder, config.past):
            for against in config.against:
                for without in config.without:
                    yield Case(folder.name, steps, without, against, changed=" ".join(config.change))


@lru_cache(maxsize=8)
def game_of(folder: Path, without: str, change: tuple[str, ...], impl: str) -> Any:
    """Makes the game of a run, in which tools are counted; equal ones compile once."""
    policy = training.Policy.load(folder)
    fields = {name: value_of(value) for name, value in (text.split("=", 1) for text in change)}
    if without == NOTHING:
        return policy.make_env(**{"tools": True, "impl": impl, **fields})
    return training.intervened(policy, without, **{"impl": impl, **fields})


def measure(case: Case, config: Config) -> Row:
    """Plays a match."""
    folder = next(one for one in config.runs if one.name == case.run)
    policy = training.Policy.load(dict(files_of(folder, True))[case.steps])
    env = game_of(folder, case.without, config.change, config.impl)
    match = training.evaluate(policy, [case.against], config.episodes, env, teams=[SEEKERS], seed=1).matches[0]
    found = {name: match.metrics[name] for name in NUMBERS if name in match.metrics}
    rows = [row for row in Folder(folder).rows() if row["steps"] <= case.steps]
    game = (policy.game or {}).get("game", "")
    return Row(
        **vars(case),
        minutes=round(rows[-1]["seconds"] / 60, 2) if rows else 0.0,
        trained=int(sum(row["episodes"] for row in rows)),
        devices=Folder(folder).about().get("conditions", {}).get("devices", []),
        episodes=match.episodes,
        stage=stage_reached(game, {name: x.mean for name, x in found.items()}),
        numbers={name: (round(x.mean, 4), round(x.margin, 4)) for name, x in found.items()},
    )


SHOWN = ("seen", "enclosed_prep", "doors_blocked_prep", "boxes_locked_prep", "max_box_move_prep", "breach", "elevated")
HEADER = f"{'run':12} {'steps':>11} {'min':>5}  {'without':20} {'against':7} " + " ".join(
    f"{name.removesuffix('_prep')[:14]:>14}" for name in SHOWN
)


def line(row: Row) -> str:
    """A row of the table."""
    shown = (row.numbers.get(name) for name in SHOWN)
    cells = (f"{x[0]:.3f} ± {x[1]:.3f}" if x else "" for x in shown)
    begin = f"{row.run[:12]:12} {row.steps:11,} {row.minutes:5.1f}  {row.without:20} {row.against:7} "
    return begin + " ".join(f"{cell:>14}" for cell in cells) + "".join(f"  {x}" for x in (row.stage, row.changed) if x)


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
