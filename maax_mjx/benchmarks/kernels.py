"""Time of a physics step of `warp` by group of its kernels, beside what their memory traffic alone would take.

The kernels are launched one by one, each between two events of CUDA's own timers (on a CPU, where a launch returns when
it is done, between two readings of the clock). A step otherwise runs as one CUDA graph; `step_us` is its time so.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, cast

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.launches import recorded
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import DISTINCT, draw_actions, env_roll, mjx_roll
from maax_mjx.benchmarks.traces import WARP_KERNEL, trace
from maax_mjx.common.annotated import PositiveCount

FILLS = "fills and copies"
LISTED = 16
"""Kernels in a row, the longest first."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: games, by name.
        worlds: batch sizes.
        played: env steps of random play, redrawn every step, before anything is timed.
        steps: env steps to time as graphs; half as many are traced by JAX's profiler.
        recorded: env steps whose kernels are launched one by one, after one to warm up.
        copied: MB that are copied on the device to measure its bandwidth.
    """

    env: tuple[str, ...] = ("standard", "hide_and_seek_quadrant", "hide_and_seek_full")
    worlds: tuple[PositiveCount, ...] = (16_384, 65_536)
    played: PositiveCount = 60
    steps: PositiveCount = 8
    recorded: PositiveCount = 2
    copied: PositiveCount = 2_000


@dataclass(frozen=True)
class Case:
    """One game, by name, in one batch size."""

    env: str
    worlds: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case; times in microseconds per physics step of all worlds.

    Attributes:
        n_frames: physics steps per env step.
        n_dofs: degrees of freedom of a world.
        step_us: as one CUDA graph, without a profiler.
        seen_us: of Warp's kernels in a trace of such steps by JAX's profiler.
        kernels_us: of all kernels, fills and copies, launched one by one.
        launches: of a step.
        iterations, most_iterations: of the solver, the mean over worlds, and of the slowest world, which all wait for.
        loop_us: of the kernels in the solver's loop.
        contacts, rows: of a world, the mean.
        copy_gb_per_s: bytes read and written per second by a large copy on the device.
        groups_us: of the kernels, by group.
        traffic_us: of the bytes of their arrays, each once, at that speed, by group.
        longest_us: of the kernels that take longest, by name.
    """

    n_frames: int
    n_dofs: int
    step_us: float
    seen_us: float
    kernels_us: float
    launches: float
    iterations: float
    most_iterations: float
    loop_us: float
    contacts: float
    rows: float
    copy_gb_per_s: float
    groups_us: dict[str, float]
    traffic_us: dict[str, float]
    longest_us: dict[str, float]


def cases(config: Config) -> Iterator[Case]:
    """Games within batch sizes."""
    return (Case(env, worlds) for worlds, env in product(config.worlds, config.env))


def measure(case: Case, config: Config) -> Row:
    """Plays at random, times steps as graphs, and records their kernels."""
    env = maax.make(case.env, impl="warp")
    worlds = maax.Worlds(env, case.worlds)
    base = env.base
    actions = draw_actions(env, case.worlds, 1)
    states = worlds.reset(jax.random.key(0))
    states = env_roll(worlds)(states, actions, jnp.arange(config.played), 1)
    engine, ids = cast("Any", base.engine), base.agents.ctrl_ids.reshape(-1)
    start, roll = mjx_roll(engine, ids, base.n_frames)
    data = start(states.world.fields, states.data)
    step_us, data = _timed(roll, data, actions, config.steps, base.n_frames)
    traced, data = _traced(roll, data, actions, max(1, config.steps // 2), base.n_frames)
    with recorded() as steps:
        _, roll = mjx_roll(engine, ids, base.n_frames)
        data = jax.block_until_ready(roll(data, actions, jnp.arange(1), 1))
        del steps[:]
        jax.block_until_ready(roll(data, actions, jnp.arange(config.recorded) % DISTINCT, 1))
        n_steps = len(steps)
    rate = copy_rate(config.copied)
    times: defaultdict[str, float] = defaultdict(float)
    traffic: defaultdict[str, float] = defaultdict(float)
    kernels: defaultdict[str, float] = defaultdict(float)
    loop = 0.0
    for launches, rest, sizes in steps:
        times[FILLS] += rest
        for launch in launches:
            times[launch.group] += launch.us
            kernels[launch.name] += launch.us
            traffic[launch.group] += launch.traffic(sizes) / rate * 1e6
            loop += launch.us * (launch.iteration >= 0)
    longest = sorted(kernels, key=lambda name: -kernels[name])[:LISTED]

    def mean(total: float) -> float:
        return round(float(total) / n_steps, 1)

    return Row(
        **vars(case),
        n_frames=base.n_frames,
        n_dofs=base.model.nv,
        step_us=round(step_us, 1),
        seen_us=round(traced, 1),
        kernels_us=mean(sum(times.values())),
        launches=mean(sum(len(launches) for launches, *_ in steps)),
        iterations=mean(sum(sizes.iterations.mean() for *_, sizes in steps)),
        most_iterations=mean(sum(sizes.iterations.max() for *_, sizes in steps)),
        loop_us=mean(loop),
        contacts=mean(sum(sizes.used_contacts for *_, sizes in steps) / case.worlds),
        rows=mean(sum(sizes.used_rows for *_, sizes in steps)),
        copy_gb_per_s=round(rate / 1e9),
        groups_us={name: mean(times[name]) for name in sorted(times, key=lambda name: -times[name])},
        traffic_us={name: mean(traffic[name]) for name in sorted(times, key=lambda name: -times[name])},
        longest_us={name: mean(kernels[name]) for name in longest},
    )


def copy_rate(megabytes: int) -> float:
    """Bytes read and written per second by a copy of so many MB on the device, the best of five."""
    x = jnp.ones((megabytes * 1_000_000 // 4,), jnp.float32)
    copy = jax.jit(lambda x: x + 1.0)
    jax.block_until_ready(copy(x))
    best = float("inf")
    for _ in range(5):
        begun = time.perf_counter()
        jax.block_until_ready(copy(x))
        best = min(best, time.perf_counter() - begun)
    return 2 * x.nbytes / best


def _timed(roll: Any, data: Any, actions: Any, steps: int, n_frames: int) -> tuple[float, Any]:
    """Microseconds of a physics step, and the data after a warm-up and the timed env steps."""
    data = jax.block_until_ready(roll(data, actions, jnp.arange(steps) % DISTINCT, 1))
    begun = time.perf_counter()
    data = jax.block_until_ready(roll(data, actions, jnp.arange(steps) % DISTINCT, 1))
    return (time.perf_counter() - begun) / (steps * n_frames) * 1e6, data


def _traced(roll: Any, data: Any, actions: Any, steps: int, n_frames: int) -> tuple[float, Any]:
    """Microseconds of Warp's kernels in a physics step that JAX's profiler sees, and the data after the env steps."""
    data = jax.block_until_ready(roll(data, actions, jnp.arange(steps) % DISTINCT, 1))
    kept = [data]

    def run() -> Any:
        kept[0] = roll(kept[0], actions, jnp.arange(steps) % DISTINCT, 1)
        return kept[0]

    seen = sum(event.end - event.start for event in trace(run) if WARP_KERNEL in event.name)
    return seen / 1e3 / (steps * n_frames), kept[0]


def line(row: Row) -> str:
    """A line about a row, the longest groups first, each beside its traffic."""
    parts = ", ".join(f"{n} {us:,.0f} ({row.traffic_us[n]:,.0f})" for n, us in row.groups_us.items() if us >= 1)
    return (
        f"{row.env}, {row.worlds} worlds: a step {row.step_us:,.0f} us, {row.launches:.0f} launches one by one"
        f" {row.kernels_us:,.0f} us, {row.loop_us:,.0f} in the solver's loop, the profiler saw {row.seen_us:,.0f};"
        f" by group (traffic alone): {parts}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
