"""How much fits: objects on the floor, contacts in the engines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import ceil

from maax_mjx.layout.grid import CELL_EPS, JAMMING
from maax_mjx.modules import Module, Placed

MIN_CONTACTS = 16


def contact_capacity(modules: Iterable[Module]) -> int:
    """Contact points per world that the engines of accelerators make room for.

    It is 31 for M. On an H200, MJX-JAX takes about as long with 24 to 30 points, and half as long again with 32, where
    its constraint rows pass 127 and XLA sums over them with another kernel (`benchmarks/profile.py`).
    """
    return max(MIN_CONTACTS, ceil(sum(module.contact_points for module in modules)))


def check_room(modules: Sequence[Module], grid_size: int, floor_size: float) -> None:
    """Refuses more objects than the floor can hold when they are placed at random.

    Raises:
        ValueError: with the free cells, the largest footprint and how many objects of it fit.
    """
    cell = floor_size / grid_size
    footprints = [(m, _footprint(extent, cell)) for m in modules for extent in m.extents]
    if not footprints:
        return
    _check_quadrant(modules, grid_size, cell)
    module, (width, height) = max(footprints, key=lambda f: f[1][0] * f[1][1])
    free = grid_size**2 - sum(m.wall_cells(grid_size) for m in modules)
    room = int(JAMMING * free / (width * height))
    if max(width, height) > grid_size:
        raise ValueError(
            f"{module.name}: got an object of {width} x {height} cells; the floor takes up to {grid_size} x {grid_size}"
        )
    if sum(w * h for _, (w, h) in footprints) > JAMMING * free:
        counts = ", ".join(f"{len(m.extents)} {m.name}" for m in modules if m.extents)
        raise ValueError(
            f"n_{module.name}: got {len(footprints)} objects in all ({counts}); the floor takes {room}: {free} free "
            f"cells over a largest footprint of {width} x {height} cells, of which random placement fills "
            f"{JAMMING:.0%}"
        )


def _footprint(extent: tuple[float, float], cell: float) -> tuple[int, int]:
    return ceil(extent[0] / cell - CELL_EPS), ceil(extent[1] / cell - CELL_EPS)


def _check_quadrant(modules: Sequence[Module], grid_size: int, cell: float) -> None:
    # Without a quadrant, placement by its name is anywhere.
    cells = min((m.quadrant_cells(grid_size) for m in modules if m.provides_quadrant), default=grid_size**2)
    inside = [
        _footprint(extent, cell)
        for m in modules
        if isinstance(m, Placed)
        for extent, fn in zip(m.extents, m.placement_fns, strict=True)
        if getattr(fn, "inside_quadrant", False)
    ]
    taken = sum(width * depth for width, depth in inside)
    if taken > JAMMING * cells:
        raise ValueError(
            f"placement_fn: got {len(inside)} objects of {taken} cells in the quadrant; the smallest has {cells}, "
            f"of which random placement fills {JAMMING:.0%}"
        )
