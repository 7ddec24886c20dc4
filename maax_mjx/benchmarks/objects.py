"""Cost of things in a world (thesis figures 6.1 and 4.3b).

The world is M with boxes instead of its box and ramp, with ramps instead, or as in the "dense" sweep of
`benchmarks.load`: M on a growing floor, with as many boxes per square metre.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import maax_mjx as maax
from maax_mjx.benchmarks import load, rollouts
from maax_mjx.benchmarks.bench import benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.rollouts import WHAT, Figures, Protocol, Rolling
from maax_mjx.common.annotated import Count, PositiveCount
from maax_mjx.common.checks import check_choice, check_positive
from maax_mjx.core.env import Base
from maax_mjx.modules.walls import OUTER
from maax_mjx.physics import check_impl

SWEEPS = ("boxes", "ramps", "floor")
JOINTS = ("slides", "free")
"""Slides along x, y and z and a yaw hinge, while the thesis had x, y and yaw; or a free joint."""


@dataclass
class Config(Protocol):
    """Options; what spans a figure comes first, so that an interrupted run is of use.

    Attributes:
        impl: engines.
        what: "env", complete env steps; "bare", the engine alone.
        worlds: batch size.
        sweeps: of "boxes", "ramps" and "floor".
        counts: how many boxes or ramps.
        outer: what closes the arena: "walls", "none".
        joints: of boxes and ramps: "slides", "free".
        edges: floors in metres of the "floor" sweep, with outer walls and slides; multiples of 0.2 m.
        density: boxes per square metre there, besides a ramp.
    """

    impl: tuple[str, ...] = ("c",)
    what: str = "env"
    worlds: PositiveCount = 256
    sweeps: tuple[str, ...] = SWEEPS
    counts: tuple[Count, ...] = (0, 9, 3, 6, 1, 7, 5, 2, 8, 4)
    outer: tuple[str, ...] = ("walls", "none")
    joints: tuple[str, ...] = JOINTS
    edges: tuple[float, ...] = (4.0, 6.0, 8.0, 10.0, 12.0)
    density: float = 0.25

    def check(self) -> None:
        super().check()
        check_choice("what", self.what, WHAT)
        check_positive("density", self.density)
        for impl in self.impl:
            check_impl(impl)
        for name, choices in (("sweeps", SWEEPS), ("outer", OUTER), ("joints", JOINTS)):
            for value in getattr(self, name):
                check_choice(name, value, choices)
        for edge in self.edges:
            load.cells(edge)


@dataclass(frozen=True)
class Case:
    """One world, besides two hiders and two seekers."""

    impl: str
    what: str
    worlds: int
    sweep: str
    n_boxes: int
    n_ramps: int
    edge_m: float
    outer: str
    joints: str


@dataclass(frozen=True)
class Row(Figures, Case, Measured):
    """A case and its figures; `build_s` is the part of `compile_s` that went into MuJoCo's model and the engine."""

    build_s: float | None = None


def cases(config: Config) -> Iterator[Case]:
    """Cases in the order of their worth; what is in two sweeps is measured in both."""
    for impl in config.impl:
        begin = partial(Case, impl, config.what, config.worlds)
        for joints in config.joints:
            for count in config.counts:
                for outer in config.outer:
                    if "boxes" in config.sweeps:
                        yield begin("boxes", count, 0, load.EDGE, outer, joints)
                    if "ramps" in config.sweeps:
                        yield begin("ramps", 0, count, load.EDGE, outer, joints)
        if "floor" in config.sweeps:
            for edge in config.edges:
                yield begin("floor", round(config.density * edge**2), 1, edge, "walls", "slides")


def world(case: Case) -> Base:
    """The environment of a case."""
    free = case.joints == "free"
    env = maax.Base(4, grid_size=load.cells(case.edge_m), floor_size=case.edge_m, impl=case.impl)
    env.add_module(maax.WallScenarios("quad", outer=case.outer))
    placement = [maax.quad_placement] * 2 + [maax.outside_quad_placement] * 2
    env.add_module(maax.Agents({"hiders": 2, "seekers": 2}, placement))
    env.add_module(maax.Boxes(case.n_boxes, free=free))
    env.add_module(maax.Ramps(case.n_ramps, free=free))
    return env


def measure(case: Case, config: Config) -> Row:
    """Builds the world, and times rollouts of a batch of it."""
    env = world(case)
    begun = time.perf_counter()
    _ = env.engine
    build_s = time.perf_counter() - begun

    def make() -> Rolling:
        return rollouts.of_worlds(maax.Worlds(env, case.worlds), case.what)

    figures = rollouts.measure(make, case.worlds, config)
    return Row(**vars(case), **vars(figures), build_s=round(build_s, 3))


HEADER = "impl  what  worlds  sweep  boxes  ramps  edge m  outer   joints     T   seconds       steps/s  build s  note"


def line(row: Row) -> str:
    """A row of the table."""
    start = (
        f"{row.impl:5} {row.what:5} {row.worlds:6} {row.sweep:6} {row.n_boxes:5} {row.n_ramps:6} {row.edge_m:7.1f}  "
        f"{row.outer:7} {row.joints:6} {row.steps:5}"
    )
    if row.seconds is None:
        return f"{start} {row.note}"
    return f"{start} {row.seconds:9.3f} {row.steps_per_s:13,.0f} {row.build_s:8.2f}"


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
