"""Memory of a batch of worlds, and the largest batch that fits.

What is counted. The states: a WorldsState as it is carried from step to step, next episodes included. The step: what
XLA says its compiled program needs, states and actions included, where what is donated counts once; the reset likewise.
JAX's pool: the most that it ever had in use, its own count, which holds neither what Warp allocates within a step, nor
MuJoCo's own batch, nor programs. The device: all that is taken on it when a step has run, as nvidia-smi counts it, pool
and whatever else runs there included; what of it is outside the pool is Warp's, the programs' and the driver's. The
host: the most that the process ever had resident.

On an accelerator every batch has a process of its own: what does not fit leaves memory behind that nothing frees, and
peaks are a process's. XLA_PYTHON_CLIENT_MEM_FRACTION says how much of a device JAX's pool may take; the rest is Warp's.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.bench import Command, Options, command_line, fill
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.runtime import is_out_of_memory

LARGEST = "largest"
"""Stands for a batch size: the largest that fits."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: environments, by name.
        impl: engines.
        worlds: batch sizes, from small to large.
        largest: whether to look for the largest batch that fits, where the device says how much it has: a power of
            two, estimated from what the two largest batches needed in JAX's pool and outside of it, and then stepped;
            half of it where that fails.
        most: worlds that are tried for it. With many more, arrays of all contacts overflow an int32.
        separate: whether every batch has a process of its own; None is on accelerators.
    """

    env: tuple[str, ...] = ("standard", "hide_and_seek", "hide_and_seek_full")
    impl: tuple[str, ...] = ("c",)
    worlds: tuple[PositiveCount, ...] = (256, 1024, 4096)
    largest: bool = False
    most: PositiveCount = 2**20
    separate: bool | None = None


@dataclass(frozen=True)
class Case:
    """One environment, by name, on one engine; `asked` is the batch size, or "largest"."""

    env: str
    impl: str
    asked: str


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case; bytes of all worlds together, unless it says per world. None is what this machine does not count.

    Attributes:
        worlds: the batch size.
        fits: whether it was reset and stepped.
        too_large: batch sizes that were tried before and did not fit.
        estimate: how many worlds there seemed to be room for.
        state_bytes_per_world: of a WorldsState.
        step_bytes, step_temporary_bytes: what the compiled step needs in all, and of it beside arguments and results.
        reset_bytes: what the compiled reset needs in all.
        pool_peak_bytes, pool_limit_bytes: of JAX's pool: the most in use so far, and what it may take.
        device_used_bytes, outside_pool_bytes: taken on the device after a step, and of it outside of the pool.
        device_bytes: all that it has.
        host_peak_bytes: the most that the process had resident so far.
        compile_s: compilation of reset and step.
        error: the first line of why it does not fit.
    """

    worlds: int
    fits: bool
    too_large: list[int]
    estimate: int | None
    state_bytes_per_world: int
    step_bytes: int | None
    step_temporary_bytes: int | None
    reset_bytes: int | None
    pool_peak_bytes: int | None
    pool_limit_bytes: int | None
    device_used_bytes: int | None
    outside_pool_bytes: int | None
    host_peak_bytes: int | None
    compile_s: float
    error: str | None
    device_bytes: int | None = None


def measure(name: str, impl: str, n_worlds: int) -> Row:
    """Compiles, resets and steps a batch twice."""
    env = maax.make(name, impl=impl)
    worlds = maax.Worlds(env, n_worlds)
    params = jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x), (n_worlds, 2)), env.default_params)
    arguments = jax.random.key(0), params, jnp.asarray(False)
    begun, compile_s = time.perf_counter(), 0.0
    lowered = jax.jit(worlds.reset_fn).lower(*arguments)
    shapes = lowered.out_info
    size = sum(math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
    needs: dict[str, Any] = {}
    pool_before, host_before = pool().get("peak_bytes_in_use", 0), host_peak()
    used, whole, error = None, None, None
    try:
        reset = lowered.compile()
        action = jax.eval_shape(worlds.sample_action, jax.random.key(0))
        step = jax.jit(worlds.step_fn, donate_argnums=0).lower(shapes, action).compile()
        compile_s = time.perf_counter() - begun
        needs["reset_bytes"], _ = needed(reset)
        needs["step_bytes"], needs["step_temporary_bytes"] = needed(step)
        states = reset(*arguments)
        for i in range(2):
            states = step(states, worlds.sample_action(jax.random.key(i)))
        # Read, not only waited for: a device says only then that it failed.
        np.asarray(states.step)
        used, whole = device_memory()
    except (RuntimeError, MemoryError) as failure:
        if not is_out_of_memory(failure):
            raise
        error = f"{type(failure).__name__}: {failure}"
    stats = pool()
    pool_peak, host = stats.get("peak_bytes_in_use", 0), host_peak()
    taken = stats.get("pool_bytes")
    return Row(
        env=name,
        impl=impl,
        asked=str(n_worlds),
        worlds=n_worlds,
        fits=error is None,
        too_large=[],
        estimate=None,
        state_bytes_per_world=round(size / n_worlds),
        step_bytes=needs.get("step_bytes"),
        step_temporary_bytes=needs.get("step_temporary_bytes"),
        reset_bytes=needs.get("reset_bytes"),
        pool_peak_bytes=pool_peak if pool_peak > pool_before else None,
        pool_limit_bytes=stats.get("bytes_limit"),
        device_used_bytes=used,
        outside_pool_bytes=None if used is None or taken is None else used - taken,
        host_peak_bytes=host if host and host > (host_before or 0) else None,
        compile_s=round(compile_s, 1),
        error=error and error.splitlines()[0][:200],
        device_bytes=whole,
    )


def measure_alone(name: str, impl: str, n_worlds: int) -> Row:
    """Measures a batch in a process of its own, which gives back all that it took."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "row.json"
        command = command_line("memory", env=name, impl=impl, worlds=n_worlds, out=out, separate=False)
        # This process leaves the pool to that one, which is to have all of it.
        subprocess.run(command, check=True, env=os.environ | {"XLA_PYTHON_CLIENT_PREALLOCATE": "true"})
        return record.read_rows(out, Row)[0]


def needed(program: Any) -> tuple[int, int] | tuple[None, None]:
    """Bytes that a compiled program needs in all, and of them temporaries; None where the backend does not count."""
    analysis = program.memory_analysis()
    if analysis is None:
        return None, None
    temporary = analysis.temp_size_in_bytes
    whole = analysis.argument_size_in_bytes + analysis.output_size_in_bytes - analysis.alias_size_in_bytes + temporary
    return whole, temporary


def pool() -> dict[str, int]:
    """JAX's own count of the first device's memory; empty on a CPU."""
    return jax.local_devices()[0].memory_stats() or {}


def device_memory() -> tuple[int, int] | tuple[None, None]:
    """Bytes taken on the first NVIDIA device by all that runs there, and all that it has; None where there is none."""
    if jax.default_backend() != "gpu":
        return None, None
    try:
        import warp

        device = warp.get_device("cuda:0")
        return device.total_memory - device.free_memory, device.total_memory
    except (ImportError, ValueError, RuntimeError):
        query = ["nvidia-smi", "--id=0", "--query-gpu=memory.used,memory.total", "--format=csv,noheader,nounits"]
        try:
            figures = subprocess.run(query, capture_output=True, check=True, text=True).stdout.split(",")
            return int(figures[0]) * 2**20, int(figures[1]) * 2**20
        except (OSError, subprocess.CalledProcessError, ValueError):
            return None, None


def host_peak() -> int | None:
    """Bytes that this process had resident at most."""
    # Linux counts in KiB, macOS in bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def estimate(rows: Sequence[Row]) -> int:
    """Number of worlds that there is room for in JAX's pool and beside it, from what the two largest batches took.

    Raises:
        RuntimeError: fewer than two batches that grow, or a device that does not say how much it has.
    """
    fitting = sorted((row for row in rows if row.fits), key=lambda row: row.worlds)[-2:]
    if len(fitting) < 2 or fitting[1].pool_limit_bytes is None:
        raise RuntimeError(
            f"largest: got {len(fitting)} batches; takes two that fit, on a device that says how much memory it has"
        )
    room = _room(
        [(row.worlds, max(row.reset_bytes or 0, row.step_bytes or 0)) for row in fitting], fitting[1].pool_limit_bytes
    )
    outside = [(row.worlds, row.outside_pool_bytes or 0) for row in fitting]
    if fitting[1].device_bytes and outside[1][1] > outside[0][1]:
        room = min(room, _room(outside, fitting[1].device_bytes - fitting[1].pool_limit_bytes))
    return room


def _room(points: list[tuple[int, int]], limit: int) -> int:
    (fewer, less), (more, most) = points
    if less >= most:
        raise RuntimeError(f"largest: got {points} worlds and bytes; takes two batches that grow")
    return int(more + (limit - most) / (most - less) * (more - fewer))


def largest(rows: Sequence[Row], most: int, measured: Callable[[int], Row]) -> Row:
    """The largest power of two, up to the estimate and to `most`, that could be stepped.

    Args:
        rows: of smaller batches.
        most: worlds that are tried.
        measured: the row of a batch size.
    """
    room = estimate(rows)
    too_large: list[int] = []
    n_worlds = min(most, 2 ** int(math.log2(max(room, 1))))
    while True:
        row = replace(measured(n_worlds), asked=LARGEST, estimate=room, too_large=too_large)
        if row.fits or n_worlds == 1:
            return row
        too_large.append(n_worlds)
        n_worlds //= 2


def line(row: Row) -> str:
    """A line about a row."""
    sizes = {
        "step": row.step_bytes,
        "reset": row.reset_bytes,
        "pool's peak": row.pool_peak_bytes,
        "outside": row.outside_pool_bytes,
        "host's peak": row.host_peak_bytes,
    }
    listed = ", ".join(f"{name} {size / 2**20:,.0f} MiB" for name, size in sizes.items() if size is not None)
    fits = "" if row.fits else f" DOES NOT FIT ({row.error})"
    return f"{row.env} {row.impl} {row.worlds:,}{fits}: a world's state {row.state_bytes_per_world:,} bytes; {listed}"


def cases(config: Config) -> Iterator[Case]:
    """The batches of an environment from small to large, as `largest` needs them."""
    asked = [str(n_worlds) for n_worlds in sorted(config.worlds)]
    if config.largest and "bytes_limit" in pool():
        asked.append(LARGEST)
    return (Case(*case) for case in product(config.env, config.impl, asked))


def main(config: Config) -> None:
    """Measures every batch that the file lacks."""
    config.check()
    # Where batches have processes of their own, this one takes nothing from them.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "true" if config.separate is False else "false")
    separate = jax.default_backend() != "cpu" if config.separate is None else config.separate
    rows = record.resume(config.out, Row)

    def measured(case: Case) -> Row:
        def one(n_worlds: int) -> Row:
            return (measure_alone if separate else measure)(case.env, case.impl, n_worlds)

        if case.asked != LARGEST:
            return one(int(case.asked))
        before = [row for row in rows if (row.env, row.impl) == (case.env, case.impl)]
        return largest(before, config.most, one)

    fill(config, rows, cases(config), measured, line)


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
