"""Where a bare `mjx.step` spends its time, by contact points: `python -m maax_mjx.benchmarks.profile --help`."""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import tyro

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.step import DISTINCT, bare_roll, draw_actions

HELD = 20


@dataclass
class Config:
    """Options.

    Attributes:
        impl: the engine, jax or warp.
        worlds: batch size.
        contacts: contact points per world that there is room for.
        steps: timed steps, after as many to warm up.
        traced: steps under the profiler; 0 leaves the profile out.
        top: how many of the longest operations to list.
        out: JSON file to write; nothing is written without one.
    """

    impl: str = "jax"
    worlds: int = 16_384
    contacts: tuple[int, ...] = (24, 32)
    steps: int = 60
    traced: int = 5
    top: int = 15
    out: Path | None = None


@dataclass
class Row:
    """One capacity: time of a step of all worlds, and of the longest operations, in microseconds a step."""

    impl: str
    worlds: int
    contacts: int
    step_us: float
    steps_per_s: float
    compile_s: float
    operations: dict[str, float]


def measure(contacts: int, config: Config) -> Row:
    """Times and traces held actions with room for `contacts`."""
    env = maax.make("standard", impl=config.impl, contacts_per_world=contacts).base
    begun = time.perf_counter()
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), config.worlds))
    start, roll = bare_roll(env)
    actions = draw_actions(env, config.worlds, HELD)
    data = start(states)
    steps = jnp.arange(config.steps)
    data = jax.block_until_ready(roll(data, actions, steps, HELD))
    compile_s = time.perf_counter() - begun
    begun = time.perf_counter()
    data = jax.block_until_ready(roll(data, actions, steps + config.steps, HELD))
    step_us = (time.perf_counter() - begun) / config.steps * 1e6
    operations: dict[str, float] = {}
    if config.traced:
        steps = jnp.arange(config.traced) + DISTINCT
        data = jax.block_until_ready(roll(data, actions, steps, HELD))
        with tempfile.TemporaryDirectory() as folder:
            with jax.profiler.trace(folder):
                jax.block_until_ready(roll(data, actions, steps, HELD))
            operations = {k: v / config.traced for k, v in longest(Path(folder), config.top).items()}
    return Row(
        impl=config.impl,
        worlds=config.worlds,
        contacts=contacts,
        step_us=round(step_us),
        steps_per_s=round(config.worlds / step_us * 1e6),
        compile_s=round(compile_s, 1),
        operations={k: round(v, 1) for k, v in operations.items()},
    )


class Event(NamedTuple):
    """One execution of an operation, its times in nanoseconds."""

    name: str
    start: float
    end: float
    stats: dict[str, Any]


def events(folder: Path) -> Iterator[Event]:
    """What a trace in `folder` saw run: on the devices' streams, or where JAX computes on the CPU, on its threads."""
    path = max(folder.rglob("*.xplane.pb"))
    for plane in jax.profiler.ProfileData.from_file(str(path)).planes:
        on_device = plane.name.startswith("/device:")
        for line in plane.lines:
            if on_device and not line.name.startswith("Stream"):
                continue
            for event in line.events:
                stats = dict(event.stats)
                if on_device or "hlo_op" in stats:
                    yield Event(event.name, event.start_ns, event.start_ns + event.duration_ns, stats)


def longest(folder: Path, top: int) -> dict[str, float]:
    """Microseconds by operation, the longest first, with the source they come from."""
    spent: defaultdict[str, float] = defaultdict(float)
    for event in events(folder):
        source = str(event.stats.get("name", ""))[-90:]
        spent[f"{event.name[:80]} | {source}"] += (event.end - event.start) / 1e3
    return dict(sorted(spent.items(), key=lambda item: -item[1])[:top])


def main(config: Config) -> None:
    """Measures every capacity, prints it, and writes the JSON after each."""
    rows = []
    for contacts in config.contacts:
        rows.append(measure(contacts, config))
        row = rows[-1]
        print(f"{row.impl} {row.contacts} contacts: {row.step_us:,.0f} us a step, {row.steps_per_s:,.0f} steps/s")
        for name, spent in row.operations.items():
            print(f"  {spent:10,.1f} us  {name}", flush=True)
        record.write(config.out, config, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
