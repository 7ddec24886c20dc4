"""Checks of placements when an environment is composed: what they measure from, and whether they can ever succeed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import jax
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from maax_mjx.layout.grid import footprint_of
from maax_mjx.layout.layout import name_of
from maax_mjx.layout.placement import anchors_of, region_of, rooms_of, separation_of
from maax_mjx.modules import Module, Placed, WallScenarios

ROUNDING = 1e-5
"""Share of a cell's edge, to either side of which places are looked for: worlds compute them in float32."""


def check_anchors(module: Placed, before: Sequence[Module]) -> None:
    """Refuses a placement near an object that is not placed before.

    Raises:
        ValueError: such a placement; the message names it and the object.
    """
    if any(other.extents and not isinstance(other, Placed) for other in before):
        return  # A module of the user's, which places things by names of its own.
    placed = [name for other in before if isinstance(other, Placed) for name in other.names]
    for i, (name, fn) in enumerate(zip(module.names, module.placement_fns, strict=True)):
        missing = anchors_of(fn) - {*placed, *module.names[: i + 1]}
        if missing:
            raise ValueError(
                f"placement_fn: got {name_of(fn)} for {name}, and no {min(missing)!r} is placed before it; takes one "
                f"of {[*placed, *module.names[:i]]}"
            )


def check_rooms(module: Placed, before: Sequence[Module]) -> None:
    """Refuses a placement in a room that no world has.

    Raises:
        ValueError: such a placement; the message names it and how many rooms there are.
    """
    walls = [other for other in before if isinstance(other, WallScenarios)]
    if not walls and not all(isinstance(other, Placed) for other in before):
        return  # A module of the user's, which may draw rooms.
    most = max((other.max_rooms for other in walls), default=0)
    for name, fn in zip(module.names, module.placement_fns, strict=True):
        if rooms_of(fn) > most:
            raise ValueError(
                f"placement_fn: got {name_of(fn)} for {name}; worlds of this environment have {most} "
                f"room{'s' * (most != 1)} at most"
            )


def check_separation(module: Placed, before: Sequence[Module], floor_size: float) -> None:
    """Refuses a placement that is further from what stands there always than the floor is wide.

    Args:
        module: the module to add.
        before: the modules that were added before it.
        floor_size: largest edge of the floor in metres.

    Raises:
        ValueError: such a placement; the message names it.
    """
    widest = np.sqrt(2) * floor_size
    there = any(least for other in before if isinstance(other, Placed) for least, _ in other.counts.values())
    always = _always(module)
    for i, (name, fn) in enumerate(zip(module.names, module.placement_fns, strict=True)):
        if separation_of(fn) > widest and (there or always[:i].any()):
            raise ValueError(
                f"placement_fn: got {name_of(fn)} for {name}, and the floor's corners are {widest:.3g} m from each "
                "other; takes less"
            )


def check_places(module: Placed, before: Sequence[Module], grid_size: int, floor_sizes: tuple[float, float]) -> None:
    """Refuses a placement that cannot succeed in any world, for what stands there always.

    That is known of regions that do not depend on the world, such as the floor's centre, of objects of one size, walls
    at the same places in every world, and objects before that have a single place.

    Args:
        module: the module to add.
        before: the modules that were added before it.
        grid_size: cells per side.
        floor_sizes: smallest and largest edge of the floor in metres.

    Raises:
        ValueError: such a placement; the message names it.
    """
    if not any(region_of(fn) for fn in module.placement_fns):
        return
    modules = [m for m in [*before, module] if isinstance(m, Placed)]
    cells = [size / grid_size * (1 + side) for size in {*floor_sizes} for side in (-ROUNDING, ROUNDING)]
    # Environments are also made inside of traced code.
    with jax.ensure_compile_time_eval():
        walls = np.logical_or.reduce([other.fixed_cells(grid_size) for other in [*before, module]])
        never = set.intersection(*(_without_place(modules, walls.copy(), cell) for cell in cells))
    for name, fn in zip(module.names, module.placement_fns, strict=True):
        if name in never:
            raise ValueError(
                f"placement_fn: got {name_of(fn)} for {name}, which has no place in any world: the floor, walls or "
                "objects that always stand there leave none of its size; takes another placement"
            )


def _without_place(modules: Iterable[Placed], taken: np.ndarray, cell: float) -> set[str]:
    """Returns the names of objects that have no place, on cells of `cell` metres that are `taken` (G, G) already."""
    without = set()
    for module in modules:
        always = _always(module)
        turns = module.random_yaw and not module.is_round
        for i, (name, fn) in enumerate(zip(module.names, module.placement_fns, strict=True)):
            region = region_of(fn)
            if region is None or module.sizes_vary:
                continue
            # However it is turned, it covers a square of its shorter edge.
            extent = (min(module.largest[i, :2].tolist()),) * 2 if turns else module.extents[i]
            cells = np.array(footprint_of(extent, cell))
            corners = _free_corners(taken, cells, *region(len(taken), np.float32(cell), cells))
            if not len(corners):
                without.add(name)
            elif len(corners) == 1 and always[i] and not turns:
                # In a valid layout it is there, so that nothing else can be.
                x, y = corners[0]
                taken[x : x + cells[0], y : y + cells[1]] = True
    return without


def _always(module: Placed) -> np.ndarray:
    """Which objects of a module are in every world, (n,) bool."""
    return np.concatenate([np.arange(most) < least for least, most in module.counts.values()])


def _free_corners(taken: np.ndarray, cells: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns the lower-left cells (n, 2) where a rectangle of `cells` (2,) lies in the region and nothing is taken."""
    low, high = np.maximum(low, 0), np.minimum(high, len(taken))
    if (high - low < cells).any():
        return np.zeros((0, 2), int)
    windows = sliding_window_view(taken[low[0] : high[0], low[1] : high[1]], tuple(cells))
    return np.argwhere(~windows.any(axis=(2, 3))) + low
