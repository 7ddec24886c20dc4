"""What derivatives through env steps cost: `python -m maax_mjx.benchmarks.gradients --help`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import tyro

import maax_mjx as maax
from maax_mjx.benchmarks import record


@dataclass
class Config:
    """Options.

    Attributes:
        steps: env steps that are differentiated through.
        repeats: of the timing, of which the mean is reported.
        out: JSON file to write; nothing is written without one.
    """

    steps: int = 20
    repeats: int = 10
    out: Path | None = None


@dataclass
class Row:
    """One way through the steps of one world of M: milliseconds, and seconds to compile."""

    what: str
    steps: int
    ms: float
    compile_s: float


def main(config: Config) -> None:
    """Times the position that actions lead to, its gradient and its Jacobian with respect to them."""
    env = maax.make("standard", impl="jax")
    state = jax.jit(env.reset)(jax.random.key(0))
    actions = jnp.full((config.steps, 4, 3), 0.5)

    def end(actions: jax.Array) -> jax.Array:
        last, _ = jax.lax.scan(lambda s, move: (env.step(s, {"move": move}), None), state, actions)
        return last.obs["agent_pos"][0, 0]

    ways: dict[str, Callable] = {"forward": end, "grad": jax.grad(end), "jacfwd": jax.jacfwd(end)}
    rows = []
    for what, way in ways.items():
        fast = jax.jit(way)
        begun = time.perf_counter()
        jax.block_until_ready(fast(actions))
        compile_s = time.perf_counter() - begun
        begun = time.perf_counter()
        for _ in range(config.repeats):
            jax.block_until_ready(fast(actions))
        ms = (time.perf_counter() - begun) / config.repeats * 1e3
        rows.append(Row(what, config.steps, round(ms, 1), round(compile_s, 1)))
        print(rows[-1], flush=True)
        record.write(config.out, config, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
