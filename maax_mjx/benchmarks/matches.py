"""What trained policies are worth: as each team against scripted agents and each other, as `training.evaluate` plays.

Opponents that cannot play a policy's game, such as those of another game, are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

from maax_mjx import training
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.training.evaluate import SELF, Evaluation, seated


@dataclass
class Config(Options):
    """Options.

    Attributes:
        policies: names, files or folders of policies, each of which plays its own game.
        against: opponents, as for `maax-mjx evaluate`.
        episodes: of each match.
        impl: engine.
    """

    policies: tuple[str, ...] = ("tag/trained",)
    against: tuple[str, ...] = ("random", "still", "chase", "tag", "capture_the_flag", SELF)
    episodes: PositiveCount = 512
    impl: Impl = "auto"


@dataclass(frozen=True)
class Case:
    """One match.

    Attributes:
        policy: the policy.
        against: the opponent.
        team: the policy's team.
        steps: env steps of the policy's training.
        against_steps: of the opponent's; 0 if it is a script or the policy itself.
    """

    policy: str
    against: str
    team: str
    steps: int
    against_steps: int = field(default=0, kw_only=True)


@dataclass(frozen=True)
class Row(Case, Measured):
    """How a match ended; pairs are a mean and half the width of its 95 % interval.

    Attributes:
        episodes: of the match.
        score: return of an agent of the team.
        won: share of the episodes in which the team had a higher return than the others, ties as half.
        numbers: the game's numbers at the end, by name.
    """

    episodes: int
    score: tuple[float, float]
    won: tuple[float, float]
    numbers: dict[str, tuple[float, float]]


def cases(config: Config) -> Iterator[Case]:
    """Cases, all matches of one policy before the next."""
    for name in config.policies:
        env, steps = _policy(name).make_env(impl=config.impl), _policy(name).steps
        for against in config.against:
            theirs = 0
            if against != SELF:
                opponent = training.player_of("against", against)
                try:
                    seated(opponent, env)
                except ValueError:
                    continue
                theirs = opponent.steps if isinstance(opponent, training.TrainedPolicy) else 0
            yield from (Case(name, against, team, steps, against_steps=theirs) for team in env.teams)


@lru_cache(maxsize=8)
def _policy(name: str) -> training.TrainedPolicy:
    found = training.player_of("policies", name)
    if not isinstance(found, training.TrainedPolicy):
        raise ValueError(f"policies: got the scripted {name!r}; takes trained ones")
    return found


@lru_cache(maxsize=1)
def _played(policy: str, against: str, episodes: int, impl: str) -> Evaluation:
    mine = _policy(policy)
    return training.evaluate(mine, [against], episodes, mine.make_env(impl=impl), seed=1)


def measure(case: Case, config: Config) -> Row:
    """Plays a match; all teams at once, so that they compile once."""
    match = _played(case.policy, case.against, config.episodes, config.impl).of(case.team, case.against)
    return Row(
        **vars(case),
        episodes=match.episodes,
        score=(round(match.score.mean, 3), round(match.score.margin, 3)),
        won=(round(match.won.mean, 4), round(match.won.margin, 4)),
        numbers={name: (round(x.mean, 4), round(x.margin, 4)) for name, x in match.metrics.items()},
    )


HEADER = f"{'policy':24} {'team':8} {'against':20} {'won':>14} {'return':>14}"


def line(row: Row) -> str:
    """A row of the table."""
    cells = " ".join(f"{mean:7.2f} ± {margin:4.2f}" for mean, margin in (row.won, row.score))
    return f"{row.policy:24} {row.team:8} {row.against:20} {cells}"


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
