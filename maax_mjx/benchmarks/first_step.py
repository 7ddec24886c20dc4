"""How long a user waits for the first step of a batch: `python -m maax_mjx.benchmarks.first_step --help`.

Every row is two processes: the first finds no compiled programs, the second those that JAX kept of the first.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro

from maax_mjx.benchmarks import record
from maax_mjx.common.checks import check_count

KEY = ("env", "impl", "worlds")
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


@dataclass
class Config:
    """Options.

    Attributes:
        env: environments, by name.
        impl: engines.
        worlds: batch sizes.
        max_minutes: after which no further row is begun; rows that `out` holds already are not measured again.
        out: JSON file to write; nothing is written without one.
    """

    env: tuple[str, ...] = ("standard", "hide_and_seek", "hide_and_seek_full")
    impl: tuple[str, ...] = ("c", "jax")
    worlds: tuple[int, ...] = (256,)
    max_minutes: float = math.inf
    out: Path | None = None


@dataclass
class Row:
    """Seconds by the clock, in the first process and in the second.

    Attributes:
        env, impl, worlds: what was stepped.
        import_s: of maax_mjx and JAX.
        make_s: of the environment, with the import of MJX, and of its batch.
        reset_s, step_s: the first ones, compilation included.
        total_s: of all that.
    """

    env: str
    impl: str
    worlds: int
    import_s: list[float]
    make_s: list[float]
    reset_s: list[float]
    step_s: list[float]
    total_s: list[float]


def measure(env: str, impl: str, worlds: int) -> Row:
    """Two processes, one after the other."""
    with TemporaryDirectory() as folder:
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": folder}
        command = [sys.executable, "-c", PROCESS, env, impl, str(worlds)]
        runs = [
            json.loads(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)
            for _ in range(2)
        ]
    spent = zip(*[[*run, sum(run)] for run in runs], strict=True)
    return Row(env, impl, worlds, *([round(seconds, 2) for seconds in both] for both in spent))


def shown(row: Row) -> str:
    """A line about a row."""
    parts = ("import", "make", "reset", "step", "total")
    told = ", ".join("{} {:.1f} and {:.1f} s".format(part, *getattr(row, f"{part}_s")) for part in parts)
    return f"{row.env} {row.impl} {row.worlds:,}: {told}"


def main(config: Config) -> None:
    """Measures every row, prints a line and writes the JSON after each."""
    for n_worlds in config.worlds:
        check_count("worlds", n_worlds, minimum=1)
    record.sweep(config, Row, KEY, product(config.env, config.impl, config.worlds), measure, shown)


if __name__ == "__main__":
    main(tyro.cli(Config))
