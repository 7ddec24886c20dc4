"""Time to load a world, by part (thesis figure 4.3a).

Loading has parts: the MuJoCo spec from the object tree, MuJoCo's model from the spec, the engine from the model, and
the compilation of reset and step by their first calls. All of it is paid once per environment; what a further layout
takes, in the same world or in any of a batch, is reported beside it. The world is M, on floors of 0.2 m cells.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax

import maax_mjx as maax
from maax_mjx.benchmarks import plots, plots_worlds
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, PositiveCount
from maax_mjx.common.checks import check_positive
from maax_mjx.physics import check_impl

CELLS_PER_METRE = 5
EDGE, N_BOXES = 6.0, 1
"""Metres, and the number of boxes, in M."""


@dataclass
class Config(Options):
    """Options; `out` gets a picture of the same name beside it.

    Attributes:
        impl: engines to load.
        edges: floors in metres to load M on; multiples of 0.2 m.
        boxes: how many boxes to load M with instead of its one, on its own floor of 6 m.
        dense_edges: floors in metres to load M on with `density` boxes per square metre, as the thesis's floors were
            filled.
        density: boxes per square metre of `dense_edges`.
        rounds: of every load, of which the median is reported, part by part.
    """

    impl: tuple[str, ...] = ("c",)
    edges: tuple[float, ...] = (6.0, 12.0, 24.0, 48.0)
    boxes: tuple[Count, ...] = (0, 1, 2, 5, 10, 15, 20)
    dense_edges: tuple[float, ...] = (4.0, 6.0, 8.0, 12.0)
    density: float = 0.25
    rounds: PositiveCount = 3

    def check(self) -> None:
        super().check()
        check_positive("density", self.density)
        for impl in self.impl:
            check_impl(impl)
        for edge in (*self.edges, *self.dense_edges):
            cells(edge)


@dataclass(frozen=True)
class Case:
    """One world, besides four agents and a ramp; what grows is "floor", "objects", or "dense", which is both."""

    impl: str
    sweep: str
    edge_m: float
    n_boxes: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case, loaded from nothing; times in seconds, medians over the rounds.

    Attributes:
        grid_size: cells per side.
        spec_s: composing the environment and writing the MuJoCo spec.
        model_s: compiling the model from it.
        engine_s: making the engine.
        reset_s: the first jitted reset of one world, compilation included.
        step_s: the first jitted step, likewise.
        total_s: sum of all these.
        next_reset_s: any further jitted reset of one world.
        compilation_cache: whether JAX had a persistent one, from which compiled programs may have come.
    """

    grid_size: int
    spec_s: float
    model_s: float
    engine_s: float
    reset_s: float
    step_s: float
    total_s: float
    next_reset_s: float
    compilation_cache: bool


def load(impl: str, edge: float, n_boxes: int) -> dict[str, Any]:
    """Seconds of every part of loading one world, by its name in `Row`."""
    spent: dict[str, float] = {}

    def timed(part: str, work: Callable[[], Any]) -> Any:
        begun = time.perf_counter()
        result = jax.block_until_ready(work())
        spent[part] = time.perf_counter() - begun
        return result

    def compose() -> maax.Base:
        env = maax.make("standard", impl=impl, floor_size=edge, grid_size=cells(edge), n_boxes=n_boxes).base
        _ = env.spec
        return env

    first, second = jax.random.split(jax.random.key(0))
    env = timed("spec_s", compose)
    timed("model_s", lambda: env.model)
    timed("engine_s", lambda: env.engine)
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    state = timed("reset_s", lambda: reset(first))
    action = env.sample_action(second)
    timed("step_s", lambda: step(state, action))
    spent["total_s"] = sum(spent.values())
    timed("next_reset_s", lambda: reset(second))
    return spent


def cells(edge: float) -> int:
    """Cells per side of a floor of `edge` metres.

    Raises:
        ValueError: a floor that is no whole number of cells.
    """
    count = round(check_positive("edges", edge) * CELLS_PER_METRE)
    if abs(count / CELLS_PER_METRE - edge) > 1e-6:
        raise ValueError(f"edges: got {edge}; takes multiples of {1 / CELLS_PER_METRE}, the edge of a cell in metres")
    return count


def cases(config: Config) -> Iterator[Case]:
    """Worlds of all sweeps, engine by engine."""
    for impl in config.impl:
        yield from (Case(impl, "floor", edge, N_BOXES) for edge in config.edges)
        yield from (Case(impl, "objects", EDGE, n_boxes) for n_boxes in config.boxes)
        yield from (Case(impl, "dense", edge, round(config.density * edge**2)) for edge in config.dense_edges)


@cache
def warm_up(impl: str) -> None:
    """Loads M once: the first load of a process pays for imports and for JAX's backend, too."""
    load(impl, EDGE, N_BOXES)


def measure(case: Case, config: Config) -> Row:
    """Loads a world in all rounds."""
    warm_up(case.impl)
    loads = [load(case.impl, case.edge_m, case.n_boxes) for _ in range(config.rounds)]
    return Row(
        **vars(case),
        grid_size=cells(case.edge_m),
        compilation_cache=bool(jax.config.values["jax_compilation_cache_dir"]),
        **{part: round(statistics.median(one[part] for one in loads), 6) for part in loads[0]},
    )


HEADER = "impl  sweep    edge m  boxes    spec   model  engine   reset    step   total  later reset  (s)"


def line(row: Row) -> str:
    """A row of the table."""
    return (
        f"{row.impl:5} {row.sweep:8} {row.edge_m:6.1f} {row.n_boxes:6} {row.spec_s:7.3f} {row.model_s:7.3f} "
        f"{row.engine_s:7.3f} {row.reset_s:7.3f} {row.step_s:7.3f} {row.total_s:7.3f} {row.next_reset_s:12.5f}"
    )


COMMAND = plots.with_picture(benchmark(Config, Row, cases, measure, line, HEADER), plots_worlds.load)

if __name__ == "__main__":
    COMMAND.cli()
