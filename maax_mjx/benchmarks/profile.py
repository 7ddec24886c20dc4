"""Time of a step of MJX's JAX physics, by stage."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, cast

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import draw_actions, mjx_roll
from maax_mjx.benchmarks.traces import attribute, shares_of, trace
from maax_mjx.common.annotated import Count, PositiveCount
from maax_mjx.common.checks import check_choice

if TYPE_CHECKING:
    from maax_mjx.physics.mjx_engine import MjxEngine

STAGES = ("fwd_position", "fwd_velocity", "fwd_actuation", "fwd_acceleration", "solve", "euler")
LINES, FACTOR, REST = "solve: line searches", "solve: factorisation", "the rest"
PARTS = (*STAGES, LINES, FACTOR, REST)
SOLVERS = ("newton", "mjx")


@dataclass
class Config(Options):
    """Options.

    Attributes:
        worlds: batch sizes.
        contacts: room for contact points per world; 0 is the environment's own choice.
        solver: "newton", the engine's own, or "mjx", plain `mjx.step`.
        held: for how many steps a full-force action is held.
        steps: timed steps, after as many to warm up; a multiple of `traced`.
        traced: steps under the profiler.
    """

    worlds: tuple[PositiveCount, ...] = (16_384,)
    contacts: tuple[Count, ...] = (0,)
    solver: tuple[str, ...] = SOLVERS
    held: PositiveCount = 20
    steps: PositiveCount = 120
    traced: PositiveCount = 20

    def check(self) -> None:
        super().check()
        for solver in self.solver:
            check_choice("solver", solver, SOLVERS)


@dataclass(frozen=True)
class Case:
    """One batch size, room for contacts and solver."""

    worlds: int
    contacts: int
    solver: str


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case: one step of all worlds, times in microseconds.

    Attributes:
        step_us: without the profiler.
        steps_per_s: all worlds added.
        compile_s: compilation of the step.
        parts_us: under the profiler, by stage of `mjx.step`. The factorisations of the matrices of "solve" and
            the loops inside its iterations, which are line searches, are counted apart.
    """

    step_us: float
    steps_per_s: float
    compile_s: float
    parts_us: dict[str, float]


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    return (Case(*case) for case in product(config.worlds, config.contacts, config.solver))


def measure(case: Case, config: Config) -> Row:
    """Times and traces held actions."""
    n_worlds = case.worlds
    env = maax.make("standard", impl="jax", contacts_per_world=case.contacts or None).base
    engine = cast("MjxEngine", env.engine)
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), n_worlds))
    # The engine has imported it, and without what it prints.
    from mujoco import mjx

    advance = mjx.step if case.solver == "mjx" else engine.mjx_step
    start, roll = mjx_roll(engine, env.agents.ctrl_ids.reshape(-1), advance=advance)
    actions, turn = draw_actions(env, n_worlds, config.held), jnp.arange(config.traced)
    data = start(states.world.fields, states.data)
    begun = time.perf_counter()
    program = roll.lower(data, actions, turn, config.held).compile()
    compile_s = time.perf_counter() - begun
    n_turns = max(1, config.steps // config.traced)
    for i in range(n_turns):
        data = program(data, actions, turn + i * config.traced, config.held)
    jax.block_until_ready(data)
    begun = time.perf_counter()
    for i in range(n_turns, 2 * n_turns):
        data = program(data, actions, turn + i * config.traced, config.held)
    jax.block_until_ready(data)
    step_us = (time.perf_counter() - begun) / (n_turns * config.traced) * 1e6
    ran = trace(lambda: program(data, actions, turn + 2 * n_turns * config.traced, config.held))
    spent, _ = attribute(ran, shares_of(program.as_text() or "", part_of), part_of, PARTS)
    return Row(
        **vars(case),
        step_us=round(step_us, 1),
        steps_per_s=round(n_worlds / step_us * 1e6),
        compile_s=round(compile_s, 1),
        parts_us={part: round(t / 1e3 / config.traced, 1) for part, t in spent.items()},
    )


def part_of(source: str) -> str:
    """The stage that an operation belongs to, from the path of scopes it was written in."""
    words = re.findall(r"\w+", source)
    stage = next((word for word in reversed(words) if word in STAGES), REST)
    if stage != "solve":
        return stage
    inside = words[words.index("solve") :]
    if any("cho" in word for word in inside):
        return FACTOR
    return LINES if "line_search" in inside or inside.count("while") > 1 else "solve"


def line(row: Row) -> str:
    """A line about a row, the largest parts first."""
    parts = sorted(row.parts_us.items(), key=lambda item: -item[1])
    listed = ", ".join(f"{part} {us:,.0f}" for part, us in parts if us >= 1)
    return f"{row.worlds} worlds, {row.solver}: {row.step_us:,.0f} us, {row.steps_per_s:,.0f} steps/s: {listed}"


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
