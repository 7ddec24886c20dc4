"""Cost of outer walls against joint limits and an open floor.

The thesis found its outer walls to be its bottleneck (section 6.3, figures 6.1 to 6.3).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import Roll, draw_actions, env_roll
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_count
from maax_mjx.common.progress import progress
from maax_mjx.modules.walls import OUTER

ROUNDS = 8
"""Turns of the boundaries in one measurement."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        impl: engines.
        worlds: batch size.
        steps: env steps per measurement, in turns of an eighth each.
        held: for how many steps an action is held; 1 redraws it every step.
    """

    impl: tuple[str, ...] = ("c",)
    worlds: PositiveCount = 256
    steps: PositiveCount = 800
    held: tuple[PositiveCount, ...] = (1, 20)

    def check(self) -> None:
        super().check()
        check_count("steps", self.steps, minimum=ROUNDS)


@dataclass(frozen=True)
class Case:
    """One boundary of M."""

    impl: str
    worlds: int
    outer: str
    held: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case; `ratio` is over `walls` in the same run."""

    contacts_per_world: int
    env_steps_per_s: float
    ratio: float
    physics_faults: int
    contact_overflows: int


@dataclass(frozen=True)
class Turns:
    """Results of a boundary in its turns.

    Attributes:
        seconds: all turns together.
        totals: counts at the end, as `WorldsState.totals` has them.
        contacts_per_world: room for contact points.
    """

    seconds: float
    totals: dict[str, int]
    contacts_per_world: int


def cases(config: Config) -> Iterator[Case]:
    """Boundaries under the same actions follow one another, since they are timed together."""
    for impl, held, outer in product(config.impl, config.held, OUTER):
        yield Case(impl, config.worlds, outer, held)


@lru_cache(maxsize=1)
def compiled(impl: str, n_worlds: int, steps: int) -> dict[str, tuple[maax.Worlds, Roll]]:
    """A batch for every boundary, and its rollout of `steps` env steps, compiled."""
    found = {}
    for outer in OUTER:
        worlds = maax.Worlds(maax.make("standard", impl=impl, outer=outer), n_worlds)
        roll = env_roll(worlds)
        actions = draw_actions(worlds.env, n_worlds, 1)
        jax.block_until_ready(roll(worlds.reset(jax.random.key(0)), actions, jnp.arange(steps), 1))
        found[outer] = worlds, roll
    return found


@lru_cache(maxsize=1)
def timed(impl: str, n_worlds: int, held: int, steps: int) -> dict[str, Turns]:
    """Results of all boundaries, stepped in turns, so that they share what the machine does besides."""
    batches = compiled(impl, n_worlds, steps // ROUNDS)
    actions = draw_actions(batches["walls"][0].env, n_worlds, held)
    latest = {outer: worlds.reset(jax.random.key(0), stagger=True) for outer, (worlds, _) in batches.items()}
    spent = dict.fromkeys(batches, 0.0)
    turns = jnp.arange(steps // ROUNDS * ROUNDS).reshape(ROUNDS, -1)
    for turn in progress(turns, desc=f"{impl} held {held}", unit="turn", leave=False):
        for outer, (_, roll) in batches.items():
            begun = time.perf_counter()
            latest[outer] = jax.block_until_ready(roll(latest[outer], actions, turn, held))
            spent[outer] += time.perf_counter() - begun
    return {
        outer: Turns(spent[outer], latest[outer].totals(), worlds.env.base.contacts_per_world)
        for outer, (worlds, _) in batches.items()
    }


def measure(case: Case, config: Config) -> Row:
    """The case's share of what is timed together."""
    found = timed(case.impl, case.worlds, case.held, config.steps)
    turns = found[case.outer]
    return Row(
        **vars(case),
        contacts_per_world=turns.contacts_per_world,
        env_steps_per_s=round(case.worlds * (config.steps // ROUNDS * ROUNDS) / turns.seconds),
        ratio=round(found["walls"].seconds / turns.seconds, 2),
        physics_faults=turns.totals["physics_fault"],
        contact_overflows=turns.totals["contact_overflow"],
    )


def line(row: Row) -> str:
    """A line about a row."""
    return (
        f"{row.impl} {row.worlds:,} worlds, {row.outer:6} held {row.held:2}: {row.env_steps_per_s:,.0f} env-steps/s, "
        f"{row.ratio:.2f} times walls; {row.physics_faults} faults, {row.contact_overflows} overflows"
    )


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
