"""Time that parts of a compiled program take, from a profile of it; parts name their operations with `jax.named_scope`.

An operation belongs to the innermost part that it is named by, and one that XLA fused from several belongs to each by
the size of what it computes for it. At every instant the operations that run share the time, so that the parts and the
idle time add up to the time traced, on any number of threads or streams.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax

IDLE, UNNAMED = "idle", "unnamed"
CONTAINERS = ("while", "conditional", "call")
"""Operations whose time is that of others."""
WARP_KERNEL = "_cuda_kernel_forward"

PartOf = Callable[[str], str]
"""Function of the path of scopes that an operation was written in to its part."""
Shares = dict[str, float]
"""Shares of an operation's time by part; they add up to 1."""


def trace(run: Callable[[], Any]) -> list[Event]:
    """Operations that ran, on all devices, in a call of `run`, which is waited for."""
    # Python's own tracer would slow the steps down, and says nothing about them.
    options = jax.profiler.ProfileOptions()
    options.python_tracer_level = 0
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder, profiler_options=options):
            jax.block_until_ready(run())
        return list(events(Path(folder)))


class Event(NamedTuple):
    """One execution of an operation, its times in nanoseconds."""

    name: str
    start: float
    end: float
    stats: dict[str, Any]


def events(folder: Path) -> Iterator[Event]:
    """Operations that a trace in `folder` saw run: on the devices' streams, or on the threads of JAX on a CPU."""
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


class Instruction(NamedTuple):
    """One line of a compiled program: an operation, and how much it computes."""

    name: str
    opcode: str
    source: str
    size: int
    calls: str


def instructions(text: str) -> Iterator[tuple[str, Instruction]]:
    """Every instruction of an HLO text, with the name of its computation."""
    computation = ""
    for line in text.splitlines():
        if opening := re.match(r"(?:ENTRY )?%([\w.\-]+) \(", line):
            computation = opening[1]
        elif (found := re.match(r"\s+(?:ROOT )?%([\w.\-]+) = (.*)", line)) and (
            opcode := re.search(r" ([a-z][\w\-]*)\(", found[2])
        ):
            source = re.search(r'op_name="([^"]*)"', line)
            calls = re.search(r"calls=%([\w.\-]+)", line)
            shape = re.search(r"\[([\d,]*)\]", found[2])
            size = math.prod(map(int, filter(None, shape[1].split(",")))) if shape else 1
            yield (
                computation,
                Instruction(found[1], opcode[1], source[1] if source else "", size, calls[1] if calls else ""),
            )


def shares_of(text: str, part_of: PartOf) -> dict[str, Shares]:
    """Parts that every operation of a compiled program works for; containers work for none."""
    inside: defaultdict[str, list[Instruction]] = defaultdict(list)
    for computation, instruction in instructions(text):
        inside[computation].append(instruction)
    shares: dict[str, Shares] = {}
    for instruction in (i for found in inside.values() for i in found):
        if instruction.opcode in CONTAINERS:
            shares[instruction.name] = {}
            continue
        weights: defaultdict[str, float] = defaultdict(float)
        for i in inside.get(instruction.calls, ()):
            if i.source and i.opcode not in ("parameter", "constant", "broadcast", "bitcast"):
                weights[part_of(i.source)] += i.size
        total = sum(weights.values())
        shares[instruction.name] = (
            {part: weight / total for part, weight in weights.items()} if total else {part_of(instruction.source): 1.0}
        )
    return shares


def attribute(
    ran: Iterable[Event], shares: Mapping[str, Shares], part_of: PartOf, parts: Iterable[str]
) -> tuple[dict[str, float], float]:
    """Nanoseconds by part, and from the first operation to the last. What runs at the same time shares it.

    Args:
        ran: what the profiler saw.
        shares: of the program's operations.
        part_of: of operations that the program does not name, but the profiler.
        parts: names of all parts, beside "unnamed" and "idle".
    """
    by_kernel = {re.sub(r"\W", "_", name): share for name, share in shares.items()}

    def share_of(event: Event) -> Shares:
        for name in (str(event.stats.get("hlo_op", "")), event.name):
            share = shares.get(name, by_kernel.get(name))
            if share is not None:
                return share
        if source := event.stats.get("name"):
            return {part_of(str(source)): 1.0}
        # Warp launches its own kernels, and does nothing but physics.
        return {"physics" if event.name.endswith(WARP_KERNEL) else UNNAMED: 1.0}

    busy = [(event, share) for event in ran if event.end > event.start and (share := share_of(event))]
    if not busy:
        raise RuntimeError("the profiler saw no operation of the program on this device")
    edges = sorted(
        [(event.start, True, i) for i, (event, _) in enumerate(busy)]
        + [(event.end, False, i) for i, (event, _) in enumerate(busy)]
    )
    spent = dict.fromkeys([*parts, UNNAMED, IDLE], 0.0)
    running: dict[int, Shares] = {}
    last = first = edges[0][0]
    for now, begins, i in edges:
        for share in running.values():
            for part, weight in share.items():
                spent[part] += weight * (now - last) / len(running)
        if not running:
            spent[IDLE] += now - last
        last = now
        if begins:
            running[i] = busy[i][1]
        else:
            running.pop(i, None)
    return spent, last - first
