"""What outer walls cost against joint limits and an open floor: `python -m maax_mjx.benchmarks.outer --help`.

The thesis found its outer walls to be its bottleneck (section 6.3, figures 6.1 to 6.3).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import tyro
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.step import draw_actions, env_roll
from maax_mjx.modules.walls import OUTER
from maax_mjx.parallel import WorldsState

ROUNDS = 8


@dataclass
class Config:
    """Options.

    Attributes:
        impl: engines.
        worlds: batch size.
        steps: env steps per measurement, in turns of an eighth each.
        held: for how many steps an action is held; 1 redraws it every step.
        out: JSON file to write; nothing is written without one.
    """

    impl: tuple[str, ...] = ("c",)
    worlds: int = 256
    steps: int = 800
    held: tuple[int, ...] = (1, 20)
    out: Path | None = None


@dataclass
class Row:
    """One boundary of M; `ratio` is over `walls` in the same run."""

    impl: str
    worlds: int
    outer: str
    held: int
    contacts_per_world: int
    env_steps_per_s: float
    ratio: float
    physics_faults: int
    contact_overflows: int


def measure(impl: str, config: Config) -> list[Row]:
    """Steps the three in turns, so that they share what the machine does besides."""
    worlds = {outer: maax.Worlds(maax.make("standard", impl=impl, outer=outer), config.worlds) for outer in OUTER}
    rolls = {outer: env_roll(w) for outer, w in worlds.items()}
    turns = jnp.arange(config.steps // ROUNDS * ROUNDS).reshape(ROUNDS, -1)
    actions = draw_actions(worlds["walls"].env.base, config.worlds, 1)
    for outer, roll in rolls.items():
        jax.block_until_ready(roll(worlds[outer].reset(jax.random.key(0)), actions, turns[0], 1))
    rows = []
    for held in config.held:
        actions = draw_actions(worlds["walls"].env.base, config.worlds, held)
        latest: dict[str, WorldsState] = {
            outer: w.reset(jax.random.key(0), stagger=True) for outer, w in worlds.items()
        }
        spent = dict.fromkeys(OUTER, 0.0)
        for steps in tqdm(turns, desc=f"{impl} held {held}", unit="turn", leave=False):
            for outer, roll in rolls.items():
                begun = time.perf_counter()
                latest[outer] = jax.block_until_ready(roll(latest[outer], actions, steps, held))
                spent[outer] += time.perf_counter() - begun
        for outer in OUTER:
            counts = latest[outer].totals()
            rows.append(
                Row(
                    impl=impl,
                    worlds=config.worlds,
                    outer=outer,
                    held=held,
                    contacts_per_world=worlds[outer].env.base.contacts_per_world,
                    env_steps_per_s=round(config.worlds * turns.size / spent[outer]),
                    ratio=round(spent["walls"] / spent[outer], 2),
                    physics_faults=counts["physics_fault"],
                    contact_overflows=counts["contact_overflow"],
                )
            )
    return rows


def main(config: Config) -> None:
    """Measures every engine, prints a table and writes the JSON after each."""
    rows: list[Row] = []
    for impl in config.impl:
        for row in measure(impl, config):
            rows.append(row)
            print(row, flush=True)
        record.write(config.out, config, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
