"""Steps per second against the number of worlds (thesis figure 6.3).

The scenes are M, M without its outer walls, and an Ant with M's time step and solver, one physics step an env step. Of
M there are complete env steps with automatic resets, and its engine alone; of the Ant the engine alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product

import maax_mjx as maax
from maax_mjx.benchmarks import rollouts
from maax_mjx.benchmarks.ant import CONTACTS, ant
from maax_mjx.benchmarks.bench import benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.rollouts import WHAT, Figures, Protocol, Rolling
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.physics import check_impl

SCENES = {"M": "walls", "M-none": "none", "M-limits": "limits", "Ant": ""}
"""Outer walls (see `WallScenarios`) by scene; the Ant has none."""


@dataclass
class Config(Protocol):
    """Options; the larger batches, which are worth the most, come first.

    Attributes:
        impl: engines.
        scenes: "M", "M-none" (an open floor), "M-limits" (closed by joint ranges), "Ant".
        what: "env", complete env steps; "bare", the engine alone; the Ant has only that.
        worlds: batch sizes.
        iterations: of the solver, and of its line searches; the thesis had 5.
        held: for how many steps an action is held.
    """

    impl: tuple[str, ...] = ("c",)
    scenes: tuple[str, ...] = ("M", "M-none", "Ant")
    what: tuple[str, ...] = WHAT
    worlds: tuple[PositiveCount, ...] = (131_072, 32_768, 8192, 2048, 512, 128, 32, 8, 2)
    iterations: tuple[PositiveCount, ...] = (20,)
    held: PositiveCount = 1

    def check(self) -> None:
        super().check()
        for impl in self.impl:
            check_impl(impl)
        for scene in self.scenes:
            check_choice("scenes", scene, SCENES)
        for what in self.what:
            check_choice("what", what, WHAT)


@dataclass(frozen=True)
class Case:
    """Measurement to be made; `outer` is what closes the arena, "" for the Ant."""

    impl: str
    scene: str
    outer: str
    what: str
    worlds: int
    iterations: int
    held: int


@dataclass(frozen=True)
class Row(Figures, Case, Measured):
    """A case and its figures."""


def cases(config: Config) -> Iterator[Case]:
    """Cases in the order of their worth: all scenes of an engine's largest batch first."""
    for impl, iterations, n_worlds, scene, what in product(
        config.impl, config.iterations, sorted(config.worlds, reverse=True), config.scenes, config.what
    ):
        if scene != "Ant" or what == "bare":
            yield Case(impl, scene, SCENES[scene], what, n_worlds, iterations, config.held)


def make(case: Case) -> Rolling:
    """The batch of a case, its first state still to be made."""
    if case.scene == "Ant":
        model = ant(maax.WorldParams().timestep, case.iterations)
        return rollouts.of_model(model, case.impl, case.worlds, CONTACTS)
    return rollouts.of_worlds(_worlds(case.impl, case.outer, case.worlds, case.iterations), case.what)


@lru_cache(maxsize=1)
def _worlds(impl: str, outer: str, n_worlds: int, iterations: int) -> maax.Worlds:
    """A batch, kept for the next case, so that "env" and "bare" compile one reset."""
    params = maax.WorldParams(iterations=iterations, ls_iterations=iterations)
    return maax.Worlds(maax.make("standard", impl=impl, outer=outer, world_params=params), n_worlds)


def measure(case: Case, config: Config) -> Row:
    """Times rollouts of a case."""
    return Row(**vars(case), **vars(rollouts.measure(partial(make, case), case.worlds, config, case.held)))


HEADER = "impl  scene     what  worlds  iterations     T  rollouts   seconds       steps/s  compile s  NaN  note"


def line(row: Row) -> str:
    """A row of the table."""
    start = f"{row.impl:5} {row.scene:9} {row.what:5} {row.worlds:6} {row.iterations:11} {row.steps:5}"
    if row.seconds is None:
        return f"{start} {row.note}"
    return (
        f"{start} {row.rollouts:9} {row.seconds:9.3f} {row.steps_per_s:13,.0f} {row.compile_s:10.1f} {row.nan_worlds:4}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
