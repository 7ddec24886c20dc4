"""Cost of derivatives through env steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount

WAYS: dict[str, Callable[[Callable[..., Any]], Callable[..., Any]]] = {
    "forward": lambda end: end,
    "grad": jax.grad,
    "jacfwd": jax.jacfwd,
}
"""Transformations of a function of the actions into what is timed: itself, its gradient, its Jacobian."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        steps: env steps that are differentiated through.
        repeats: of the timing, of which the mean is reported.
    """

    steps: PositiveCount = 20
    repeats: PositiveCount = 10


@dataclass(frozen=True)
class Case:
    """One of `WAYS`, through so many steps of one world of M."""

    what: str
    steps: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case: milliseconds of a call, and seconds to compile."""

    ms: float
    compile_s: float


def cases(config: Config) -> Iterator[Case]:
    """Ways of differentiating, and none."""
    return (Case(what, config.steps) for what in WAYS)


def measure(case: Case, config: Config) -> Row:
    """Times the position that actions lead to, or its derivative with respect to them."""
    env = maax.make("standard", impl="jax")
    state = jax.jit(env.reset)(jax.random.key(0))
    actions = jnp.full((case.steps, 4, 3), 0.5)

    def end(actions: jax.Array) -> jax.Array:
        last, _ = jax.lax.scan(lambda s, move: (env.step(s, {"move": move}), None), state, actions)
        return last.obs["agent_pos"][0, 0]

    fast = jax.jit(WAYS[case.what](end))
    begun = time.perf_counter()
    jax.block_until_ready(fast(actions))
    compile_s = time.perf_counter() - begun
    begun = time.perf_counter()
    for _ in range(config.repeats):
        jax.block_until_ready(fast(actions))
    ms = (time.perf_counter() - begun) / config.repeats * 1e3
    return Row(**vars(case), ms=round(ms, 1), compile_s=round(compile_s, 1))


def line(row: Row) -> str:
    """A line about a row."""
    return f"{row.what}: {row.ms} ms through {row.steps} steps, compiled in {row.compile_s} s"


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
