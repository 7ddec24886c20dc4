"""Growth of env steps with devices.

Every device has as many worlds, with one device as with many, so that twice the devices make twice the steps at best.
Rollouts are those of `Worlds.rollout`, under random actions redrawn every step.
"""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.bench import Command, Options, command_line, fill
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: environment, by name.
        impl: engines.
        worlds: of every device.
        devices: how many, as far as there are; always one first.
        method: how several are used.
        processes: whether as many processes with a device each are timed too.
        steps: env steps of a rollout.
        rollouts: how many are timed, after one to warm up.
        rank, coordinator: given to the processes that this one starts.
    """

    env: str = "hide_and_seek"
    impl: tuple[str, ...] = ("warp",)
    worlds: PositiveCount = 16_384
    devices: tuple[PositiveCount, ...] = (2,)
    method: tuple[str, ...] = ("shard_map", "pmap")
    processes: bool = True
    steps: PositiveCount = 200
    rollouts: PositiveCount = 5
    rank: PositiveCount | None = None
    coordinator: str | None = None


@dataclass(frozen=True)
class Case:
    """Measurement to be made; `worlds` is per device."""

    env: str
    impl: str
    worlds: int
    devices: int
    processes: int
    method: str


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case with its env-steps per second of all worlds, and how many times those of one device that is."""

    steps: int
    rollouts: int
    env_steps_per_s: float
    times_one: float | None
    compile_s: float
    physics_faults: int
    episodes_ended: int


def cases(config: Config) -> Iterator[Case]:
    """Cases, one device first, which the others are compared with."""
    for impl in config.impl:
        yield Case(config.env, impl, config.worlds, 1, 1, "jit")
        for n in config.devices:
            for method in config.method:
                yield Case(config.env, impl, config.worlds, n, 1, method)
            if config.processes:
                yield Case(config.env, impl, config.worlds, n, n, "shard_map")


def measure(case: Case, config: Config) -> Row:
    """Times rollouts of a case in this process."""
    begun = time.perf_counter()
    env = maax.make(case.env, impl=case.impl)
    worlds = maax.Worlds(env, case.worlds * case.devices, case.devices, case.method)

    def policy(state: maax.State, key: jax.Array) -> dict[str, jax.Array]:
        return env.sample_action(key)

    states = worlds.reset(jax.random.key(0), stagger=True)
    states, _ = jax.block_until_ready(worlds.rollout(states, policy, config.steps))
    ready = time.perf_counter()
    for i in range(config.rollouts):
        states, _ = worlds.rollout(states, policy, config.steps, key=jax.random.key(i))
    jax.block_until_ready(states)
    spent = time.perf_counter() - ready
    counts = states.totals()
    return Row(
        **asdict(case),
        steps=config.steps,
        rollouts=config.rollouts,
        env_steps_per_s=round(worlds.n_worlds * config.steps * config.rollouts / spent),
        times_one=None,
        compile_s=round(ready - begun, 1),
        physics_faults=counts["physics_fault"],
        episodes_ended=counts["episodes"],
    )


def measure_processes(case: Case, config: Config) -> Row:
    """Times a case in processes of their own, a device each."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        coordinator = f"localhost:{free.getsockname()[1]}"
    with TemporaryDirectory() as folder:
        out = Path(folder) / "row.json"
        options: dict[str, Any] = {"env": case.env, "impl": case.impl, "worlds": case.worlds, "devices": case.devices}
        options |= {"steps": config.steps, "rollouts": config.rollouts, "out": out, "coordinator": coordinator}
        command = [*command_line("devices", **options), "--no-processes"]
        children = [
            subprocess.Popen([*command, "--rank", str(i)], env=os.environ | {"CUDA_VISIBLE_DEVICES": str(i)})
            for i in range(case.processes)
        ]
        if any([child.wait() for child in children]):
            raise RuntimeError(f"{case}: a process failed; its output is above")
        return record.read_rows(out, Row)[0]


def child(config: Config) -> None:
    """Measures in one of several processes; the first of them writes the row."""
    n = config.devices[0]
    jax.distributed.initialize(config.coordinator, n, config.rank)
    row = measure(Case(config.env, config.impl[0], config.worlds, n, n, "shard_map"), config)
    if jax.process_index() == 0:
        record.write(config.out, [row])


def line(row: Row) -> str:
    """A line about a row."""
    return (
        f"{row.env} {row.impl} {row.devices} device(s), {row.processes} process(es), {row.method}: "
        f"{row.env_steps_per_s:,.0f} env-steps/s, {row.times_one} times one"
    )


def main(config: Config) -> None:
    """Measures every case that the file lacks, as far as there are devices."""
    config.check()
    if config.rank is not None:
        return child(config)
    # This process keeps no memory from those that it starts on the same devices.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    rows = record.resume(config.out, Row)
    present = len(jax.devices())

    def measured(case: Case) -> Row:
        row = (measure if case.processes == 1 else measure_processes)(case, config)
        ones = [r.env_steps_per_s for r in (*rows, row) if r.devices == 1 and (r.env, r.impl) == (row.env, row.impl)]
        return replace(row, times_one=round(row.env_steps_per_s / ones[0], 3) if ones else None)

    fill(config, rows, [case for case in cases(config) if case.devices <= present], measured, line)


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
