"""Waiting time until the first step of a batch.

Every row is two processes: the first finds no compiled programs, the second those that JAX kept of the first.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from tempfile import TemporaryDirectory
from typing import Any

from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount

PROCESS = """
import json, sys, time
times = [time.perf_counter()]
import jax, maax_mjx as maax
times.append(time.perf_counter())
worlds = maax.Worlds(maax.make(sys.argv[1], impl=sys.argv[2]), int(sys.argv[3]))
times.append(time.perf_counter())
states = jax.block_until_ready(worlds.reset(jax.random.key(0)))
times.append(time.perf_counter())
jax.block_until_ready(worlds.step(states, worlds.sample_action(jax.random.key(1))))
times.append(time.perf_counter())
print(json.dumps([after - before for before, after in zip(times, times[1:])]))
"""
"""Program of both processes; it prints the seconds of all parts but the total."""
PARTS = ("import", "make", "reset", "step", "total")


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: environments, by name.
        impl: engines.
        worlds: batch sizes.
    """

    env: tuple[str, ...] = ("standard", "hide_and_seek", "hide_and_seek_full")
    impl: tuple[str, ...] = ("c", "jax")
    worlds: tuple[PositiveCount, ...] = (256,)


@dataclass(frozen=True)
class Case:
    """One environment, by name, on one engine in one batch size."""

    env: str
    impl: str
    worlds: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case: seconds by the clock, in the first process and in the second.

    Attributes:
        import_s: import of maax_mjx and JAX.
        make_s: construction of the environment, with the import of MJX, and of its batch.
        reset_s, step_s: the first ones, compilation included.
        total_s: sum of all that.
    """

    import_s: list[float]
    make_s: list[float]
    reset_s: list[float]
    step_s: list[float]
    total_s: list[float]


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    return (Case(*case) for case in product(config.env, config.impl, config.worlds))


def measure(case: Case, config: Config) -> Row:
    """Runs two processes, one after the other."""
    with TemporaryDirectory() as folder:
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": folder}
        command = [sys.executable, "-c", PROCESS, case.env, case.impl, str(case.worlds)]
        runs = [_times(command, environment) for _ in range(2)]
    first, second = ([round(seconds, 2) for seconds in (*run, sum(run))] for run in runs)
    both: dict[str, Any] = {f"{part}_s": list(seconds) for part, *seconds in zip(PARTS, first, second, strict=True)}
    return Row(**vars(case), **both)


def _times(command: list[str], environment: dict[str, str]) -> list[float]:
    printed = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
    # Whatever is before that line was printed by the file of a game.
    times: list[float] = json.loads(printed.splitlines()[-1])
    return times


def line(row: Row) -> str:
    """A line about a row."""
    seconds = ", ".join("{} {:.1f} and {:.1f} s".format(part, *getattr(row, f"{part}_s")) for part in PARTS)
    return f"{row.env} {row.impl} {row.worlds:,}: {seconds}"


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
