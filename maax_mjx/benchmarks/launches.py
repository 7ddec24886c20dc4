"""Launches of Warp's kernels in physics steps: how long each took, what it belongs to, and the bytes that it moved."""

from __future__ import annotations

import inspect
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from maax_mjx.common.runtime import import_mjx

LINES, FACTOR, HESSIAN, REPAIR = "solver: line search", "solver: factorisation", "solver: Hessian", "solver: repair"
SOLVER, ALL = "solver: the rest", "solver: all iterations of a world"
ROWS, BROAD, SIMPLE = "constraint rows", "collision: broad phase", "collision: simple pairs"
SMOOTH, MOTION, OTHER = "kinematics and inertia", "integration", "the rest"
CONVEX = "collision: convex, "
IN_SOLVER = (("linesearch", LINES), ("cholesky|padding_h", FACTOR), ("JTD|_h_|init_h|Hessian|hessian|metric", HESSIAN))
"""Patterns of names of the solver's kernels, and their groups."""
MODULES = {
    "collision_driver": BROAD,
    "collision_primitive": SIMPLE,
    "constraint": ROWS,
    "warp_hessian": REPAIR,
    "warp_newton": ALL,
    "smooth": SMOOTH,
    "passive": SMOOTH,
    "support": SMOOTH,
    "derivative": MOTION,
    "forward": MOTION,
}
"""Groups of the kernels of a module, by the last part of its name."""


@dataclass
class Launch:
    """One launch of a kernel.

    Attributes:
        name: the kernel's function.
        group: what it belongs to.
        iteration: of the solver's loop, from 0; -1 outside of it.
        arrays: the shape, strides and bytes per element of each array that it got.
        us: microseconds that it took.
    """

    name: str
    group: str
    iteration: int
    arrays: list[tuple[tuple[int, ...], tuple[int, ...], int]]
    us: float = 0.0

    def traffic(self, sizes: Sizes) -> float:
        """Bytes of its arrays, each element once, as far as worlds, rows and contacts are in use.

        The least that it moves, unless it finds its arrays in a cache: what it reads and writes counts once, and what
        it reads again not at all.
        """
        active = sizes.active(self.iteration)
        return active * sum(item * sizes.elements(shape, strides) for shape, strides, item in self.arrays)


@dataclass
class Sizes:
    """How much of a step's arrays is in use.

    Attributes:
        worlds, contacts, pairs, rows, entries: room for worlds, for contacts of all worlds, for their convex pairs'
            scratch, and for rows and for entries of the sparse Jacobian of a world.
        used_contacts: contacts of all worlds.
        used_rows, used_entries: rows and entries of a world in the mean.
        iterations: (worlds,) of the solver.
    """

    worlds: int
    contacts: int
    pairs: int
    rows: int
    entries: int
    used_contacts: float
    used_rows: float
    used_entries: float
    iterations: np.ndarray = field(repr=False)

    def active(self, iteration: int) -> float:
        """Share of the worlds that the solver still works on in an iteration of its loop; all outside of it."""
        return 1.0 if iteration < 0 else float((self.iterations > iteration).mean())

    def elements(self, shape: tuple[int, ...], strides: tuple[int, ...]) -> float:
        """Elements in use of an array; an axis of stride 0 is one that all share, and scratch counts nothing."""
        if shape and shape[0] == self.pairs:
            return 0.0
        lengths = [float(length) if stride else min(length, 1) for length, stride in zip(shape, strides, strict=True)]
        if shape and shape[0] == self.contacts:
            lengths[0] = self.used_contacts
        elif len(shape) > 1 and shape[0] == self.worlds:
            if len(shape) == 3 and shape[2] == self.entries and self.used_entries < self.entries:
                lengths[2] = self.used_entries
            elif shape[1] == self.rows:
                lengths[1] = self.used_rows
        return float(np.prod(lengths))


def group_of(kernel: Any) -> str:
    """The group of a kernel, from the module that it is written in, its name, and for convex pairs their kinds."""
    module = kernel.func.__module__.rpartition(".")[2]
    if module == "solver":
        return next((group for pattern, group in IN_SOLVER if re.search(pattern, kernel.key)), SOLVER)
    if module == "collision_convex":
        return CONVEX + _pair_kind(kernel)
    return MODULES.get(module, OTHER)


def _pair_kind(kernel: Any) -> str:
    found = inspect.getclosurevars(kernel.func).nonlocals
    kinds = [found.get(name) for name in ("geomtype1", "geomtype2")]
    return " and ".join(
        "any" if kind is None else mujoco.mjtGeom(int(kind)).name.removeprefix("mjGEOM_").lower() for kind in kinds
    )


@contextmanager
def recorded() -> Iterator[list[tuple[list[Launch], float, Sizes]]]:
    """Records physics steps of programs traced and run inside: their launches, the time of all else, and the sizes.

    Yields:
        A list that grows by one entry a step: its launches, microseconds of fills and copies, and sizes.
    """
    import warp

    # MJX says on the standard output which engines are not installed, unless it is imported so.
    import_mjx()
    from maax_mjx.physics.mjx_internals import launched_one_by_one, step_sizes

    launch, tiled, loop = warp.launch, warp.launch_tiled, warp.capture_while
    steps: list[tuple[list[Launch], float, Sizes]] = []
    launches: list[Launch] = []
    iteration = -1

    def noting(launch: Callable[..., Any]) -> Callable[..., Any]:
        def noted(kernel: Any, *args: Any, **kwargs: Any) -> Any:
            if not np.prod(args[0] if args else kwargs["dim"]):
                return None  # Warp launches nothing
            given = [*(args[1] if len(args) > 1 else kwargs.get("inputs", ())), *kwargs.get("outputs", ())]
            arrays = [
                (tuple(a.shape), tuple(a.strides), warp.types.type_size_in_bytes(a.dtype))
                for a in given
                if isinstance(a, warp.array)
            ]
            launches.append(Launch(kernel.key, group_of(kernel), iteration, arrays))
            begun = time.perf_counter()
            out = launch(kernel, *args, **kwargs)
            launches[-1].us = 1e6 * (time.perf_counter() - begun)
            return out

        return noted

    def counted(condition: Any, while_body: Callable[..., Any], *args: Any, **kwargs: Any) -> None:
        def body(**kwargs: Any) -> None:
            nonlocal iteration
            iteration += 1
            while_body(**kwargs)

        nonlocal iteration
        loop(condition, body, *args, **kwargs)
        iteration = -1

    def timed(step: Callable[[Any, Any], None], m: Any, d: Any) -> None:
        launches.clear()
        on_cuda = d.qpos.device.is_cuda
        if on_cuda:
            warp.timing_begin(cuda_filter=warp.TIMING_ALL)
        step(m, d)
        rest = 0.0
        if on_cuda:
            results = warp.timing_end()
            kernels = [r for r in results if r.filter == warp.TIMING_KERNEL]
            if len(kernels) != len(launches):
                raise RuntimeError(f"Warp timed {len(kernels)} kernels of {len(launches)}")
            for one, result in zip(launches, kernels, strict=True):
                one.us = 1e3 * result.elapsed
            rest = 1e3 * sum(r.elapsed for r in results if r.filter != warp.TIMING_KERNEL)
        steps.append(([*launches], rest, Sizes(**step_sizes(d))))

    warp.launch, warp.launch_tiled, warp.capture_while = noting(launch), noting(tiled), counted
    try:
        with launched_one_by_one(timed):
            yield steps
    finally:
        warp.launch, warp.launch_tiled, warp.capture_while = launch, tiled, loop
