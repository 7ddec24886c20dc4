"""What agents learn in some minutes: trained teams against random ones, beside random teams against random ones.

Every row trains a new run with a seed of its own and plays it afterwards, as each team, against random actions.
`caught` is the share of the steps after preparation in which a hider is caught by the game's rule: by sight in the
published games, by touch in the thesis's. Runs stay in `--runs`, where `maax-mjx evaluate` and `maax-mjx train` find
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

from maax_mjx import training
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, Positive, PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.training.ratings import LIKELY
from maax_mjx.wrappers.teams import HIDERS, SEEKERS

RANDOM, CAUGHT = "random", "caught"


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: games of hiders and seekers, by name.
        preset: settings of the training.
        seeds: of the runs.
        minutes: of training, compilation not included.
        episodes: of each match.
        runs: folder for the runs; a run that is there already goes on only if its minutes are not over.
    """

    env: tuple[str, ...] = ("hide_and_seek_quadrant",)
    preset: tuple[str, ...] = ("laptop",)
    seeds: tuple[Count, ...] = (0, 1, 2)
    minutes: tuple[Positive, ...] = (5.0,)
    episodes: PositiveCount = 1024
    runs: Path = Path("runs") / "learning"

    def check(self) -> None:
        super().check()
        for preset in self.preset:
            check_choice("preset", preset, training.PRESETS)


@dataclass(frozen=True)
class Case:
    """One run."""

    env: str
    preset: str
    seed: int
    minutes: float
    episodes: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """What a run learnt. Margins are half the widths of 95 % intervals.

    Attributes:
        steps: env steps of training.
        env_steps_per_s: of training.
        compile_s: seconds to the end of the first iteration.
        random, random_margin: caught, if all act at random.
        seekers, seekers_margin: caught, if trained seekers play random hiders.
        hiders, hiders_margin: caught, if random seekers play trained hiders.
        gain, gain_margin: `seekers` less `random`.
        faults: physics faults per million env steps of the training.
    """

    steps: int
    env_steps_per_s: float
    compile_s: float
    random: float
    random_margin: float
    seekers: float
    seekers_margin: float
    hiders: float
    hiders_margin: float
    gain: float
    gain_margin: float
    faults: float


def cases(config: Config) -> Iterator[Case]:
    """Cases, all games and presets with one seed before the next seed."""
    for seed, minutes, env, preset in product(config.seeds, config.minutes, config.env, config.preset):
        yield Case(env, preset, seed, minutes, config.episodes)


@lru_cache(maxsize=4)
def by_chance(env: str, preset: str, episodes: int) -> training.Estimate:
    """How often hiders are caught if all act at random."""
    game = training.environment_of(env, training.preset(preset), None)
    found = training.evaluate(RANDOM, [RANDOM], episodes, game, teams=[SEEKERS], seed=1)
    return found.of(SEEKERS, RANDOM).metrics[CAUGHT]


def measure(case: Case, config: Config) -> Row:
    """Trains a run and plays it."""
    folder = config.runs / f"{case.env}_{case.preset}_{case.minutes:g}_{case.seed}"
    trainer = training.Trainer(case.env, folder, case.preset, seed=case.seed)
    left = case.minutes - trainer.seconds / 60
    if left > 0:
        with training.Bar(left) as bar:
            trainer.run(left, on_iteration=bar.of(trainer))
    rows = trainer.folder.rows()
    found = training.evaluate(trainer.policy, [RANDOM], case.episodes, seed=1)
    seekers, hiders = (found.of(team, RANDOM).metrics[CAUGHT] for team in (SEEKERS, HIDERS))
    chance = by_chance(case.env, case.preset, case.episodes)
    errors = (seekers.margin / LIKELY) ** 2 + (chance.margin / LIKELY) ** 2
    return Row(
        **vars(case),
        random=round(chance.mean, 4),
        random_margin=round(chance.margin, 4),
        seekers=round(seekers.mean, 4),
        seekers_margin=round(seekers.margin, 4),
        hiders=round(hiders.mean, 4),
        hiders_margin=round(hiders.margin, 4),
        steps=trainer.steps,
        env_steps_per_s=round(trainer.steps / trainer.seconds),
        compile_s=round(sum(row.get("compile_s") or 0.0 for row in rows), 1),
        gain=round(seekers.mean - chance.mean, 4),
        gain_margin=round(LIKELY * errors**0.5, 4),
        faults=round(1e6 * sum(row["faults"] for row in rows) / trainer.steps, 1),
    )


HEADER = (
    "env                    preset  seed  minutes      steps    env/s  random  seekers  hiders   gain        faults/M"
)


def line(row: Row) -> str:
    """A row of the table."""
    return (
        f"{row.env:22} {row.preset:7} {row.seed:4} {row.minutes:7.1f} {row.steps:10,} {row.env_steps_per_s:7,.0f} "
        f"{row.random:6.3f} {row.seekers:7.3f} {row.hiders:6.3f} {row.gain:+7.3f} ± {row.gain_margin:.3f} "
        f"{row.faults:7.1f}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
