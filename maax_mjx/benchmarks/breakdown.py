"""Time of an env step of a game, by part.

It is measured by a profile of scanned env steps with staggered automatic resets, whose layers name their operations;
see `traces`. Tracing costs time itself: `traced_over_step` compares that sum with the same steps timed without it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import draw_actions, env_roll
from maax_mjx.benchmarks.traces import IDLE, attribute, shares_of, trace
from maax_mjx.common.annotated import PositiveCount

REST, RESET = "the rest", "layout and reset"
PARTS = {
    "physics": ("physics",),
    RESET: ("reset",),
    "observations": ("observations", "SplitObservations", "_HandledObjects", "MaskObservations", "FlattenObservations"),
    "vision": ("LineOfSight",),
    "lidar": ("Lidar",),
    "locks": ("LockObjects",),
    "grabs": ("GrabObjects",),
    "rewards": ("HideAndSeekReward", "RestrictAgentsRect"),
    REST: ("Base", "TeamMembership", "AgentAgentContactMask2D", "PreparationPhase", "TrackStats", "DiscretizeActions"),
}
"""Names of operations, by part. The rest is also what `Worlds` does, and what is copied from step to step."""
PART_OF = {name: part for part, names in PARTS.items() for name in names}


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: games to profile, by name.
        impl: engines.
        worlds: batch sizes.
        steps: env steps to time without a profile.
        traced: env steps under the profiler. A chunk of layouts is drawn every `horizon` / 16 steps (of batches below
            1,024 worlds, more rarely), so that this should be a multiple of it.
        horizon: env steps per episode.
        held: for how many steps a full-force action is held.
    """

    env: tuple[str, ...] = ("hide_and_seek", "hide_and_seek_full")
    impl: tuple[str, ...] = ("c",)
    worlds: tuple[PositiveCount, ...] = (256,)
    steps: PositiveCount = 120
    traced: PositiveCount = 60
    horizon: PositiveCount = 240
    held: PositiveCount = 20


@dataclass(frozen=True)
class Case:
    """One game, by name, on one engine in one batch size."""

    env: str
    impl: str
    worlds: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case, times in microseconds per env step of all worlds.

    Attributes:
        n_frames: physics steps per env step.
        horizon, held: as the options had them.
        env_steps_per_s: all worlds added, without the profiler.
        step_us: of an env step, without the profiler.
        traced_us: of an env step under the profiler, from the first operation to the last.
        parts_us: by part, what of `traced_us` its operations took. "unnamed" are operations that no program names,
            "idle" is when none ran.
        parts_over_traced: the sum of all parts, idle included, over `traced_us`: 1, but for rounding.
        busy_over_step: the sum of all parts without "idle" over `step_us`.
        traced_over_step: `traced_us` over `step_us`: what the profiler costs.
        events: operations traced, per env step.
        compile_s: compilation of the step.
    """

    n_frames: int
    horizon: int
    held: int
    env_steps_per_s: float
    step_us: float
    traced_us: float
    parts_us: dict[str, float]
    parts_over_traced: float
    busy_over_step: float
    traced_over_step: float
    events: int
    compile_s: float


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    return (Case(*case) for case in product(config.env, config.impl, config.worlds))


def measure(case: Case, config: Config) -> Row:
    """Times and traces a game's env steps."""
    n_worlds = case.worlds
    env = maax.make(case.env, impl=case.impl, horizon=config.horizon)
    worlds = maax.Worlds(env, n_worlds)
    states = worlds.reset(jax.random.key(0), stagger=True)
    actions = draw_actions(env, n_worlds, config.held)
    begun = time.perf_counter()
    # One program for all turns, whose text says what its operations are.
    turn = jnp.arange(config.traced)
    program = jax.jit(env_roll(worlds), donate_argnums=0).lower(states, actions, turn, config.held).compile()
    compile_s = time.perf_counter() - begun
    states = jax.block_until_ready(program(states, actions, turn, config.held))
    n_turns = max(1, config.steps // config.traced)
    begun = time.perf_counter()
    for i in range(1, n_turns + 1):
        states = jax.block_until_ready(program(states, actions, turn + i * config.traced, config.held))
    step_us = (time.perf_counter() - begun) / (n_turns * config.traced) * 1e6
    ran = trace(lambda: program(states, actions, turn + (n_turns + 1) * config.traced, config.held))
    spent, window = attribute(ran, shares_of(program.as_text() or "", part_of), part_of, PARTS)
    traced_us = window / 1e3 / config.traced
    parts = {part: t / 1e3 / config.traced for part, t in spent.items()}
    return Row(
        **vars(case),
        n_frames=env.base.n_frames,
        horizon=config.horizon,
        held=config.held,
        env_steps_per_s=round(n_worlds / step_us * 1e6),
        step_us=round(step_us, 1),
        traced_us=round(traced_us, 1),
        parts_us={part: round(us, 2) for part, us in parts.items()},
        parts_over_traced=round(sum(parts.values()) / traced_us, 3),
        busy_over_step=round((sum(parts.values()) - parts[IDLE]) / step_us, 3),
        traced_over_step=round(traced_us / step_us, 3),
        events=round(len(ran) / config.traced),
        compile_s=round(compile_s, 1),
    )


def part_of(source: str) -> str:
    """The part that an operation belongs to, from the path of scopes it was written in."""
    words = re.findall(r"\w+", source)
    if "reset" in words:
        return RESET
    return next((PART_OF[word] for word in reversed(words) if word in PART_OF), REST)


def line(row: Row) -> str:
    """A line about a row, the largest parts first."""
    parts = sorted(row.parts_us.items(), key=lambda item: -item[1])
    listed = ", ".join(f"{part} {us / row.traced_us:.1%}" for part, us in parts if us)
    return (
        f"{row.env} {row.impl} {row.worlds}: {row.step_us:,.0f} us a step, {row.traced_us:,.0f} traced, "
        f"busy {row.busy_over_step:.2f} of a step: {listed}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
