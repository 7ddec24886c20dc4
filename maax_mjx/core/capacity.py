"""Checks that a module fits an environment: the other modules, the floor, the engines' contacts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from math import ceil

from maax_mjx.core.places import check_anchors, check_places, check_rooms, check_separation
from maax_mjx.layout.grid import JAMMING, footprint_of
from maax_mjx.modules import Agents, Entities, Module, Placed

MIN_CONTACTS = 16
"""Contact points per world that engines make room for at least."""


def contact_capacity(modules: Iterable[Module]) -> int:
    """Returns how many contact points per world the `jax` and `warp` engines make room for.

    The benchmarks' environment M has 31. On an H200, MJX-JAX takes about as long with 24 to 30 points, and half as long
    again with 32: its constraint rows pass 127, and XLA sums over them with another kernel (`benchmarks/profile.py`).
    """
    return max(MIN_CONTACTS, ceil(sum(module.contact_points for module in modules)))


def check_module(
    module: Module, before: Sequence[Module], n_agents: int, grid_size: int, floor_sizes: tuple[float, float]
) -> None:
    """Refuses a module that does not fit.

    Args:
        module: the module to add.
        before: the modules that were added before it.
        n_agents: number of the environment's agents.
        grid_size: cells per side.
        floor_sizes: smallest and largest edge of the floor in metres.

    Raises:
        ValueError: a module that does not fit; the message names the argument.
    """
    name = getattr(module, "name", None)
    if isinstance(module, Placed) and not hasattr(module, "count"):
        mine = type(module).__name__
        raise ValueError(f"module: {mine} was not made; takes a first line super().__init__(...) in its __init__")
    if not isinstance(name, str) or not name:
        mine = type(module).__name__
        raise ValueError(f"name: {mine} has {name!r}; takes a text of its own, in the class: name = {mine.lower()!r}")
    if module.name in [m.name for m in before]:
        raise ValueError(f"module: got a second {module.name!r}; takes one of each, by name")
    if isinstance(module, Agents) and module.n_max != n_agents:
        raise ValueError(f"n_agents: Base got {n_agents}, Agents got {module.n_max}; both take the same number")
    if module.requires_quadrant and not any(m.provides_quadrant for m in before):
        raise ValueError(
            f"placement_fn: got one that places {type(module).__name__} by the quadrant, and there is none; takes "
            'another, or add WallScenarios(scenario="quad") before it'
        )
    if module.wall_cells(grid_size) and any(m.extents for m in before):
        raise ValueError(
            f"module: got {type(module).__name__} after what it would be built over; takes walls before anything else"
        )
    for other in before:
        shared = sorted({p.name for p in other.parameters} & {p.name for p in module.parameters})
        if shared:
            raise ValueError(
                f"module: {type(module).__name__} has a parameter {shared[0]!r}, as {type(other).__name__} has; "
                "takes names of its own"
            )
    modules = [*before, module]
    for m in modules:
        if isinstance(m, Entities) and m.free and any(other.limits_arena for other in modules):
            raise ValueError(
                f"free: got True for {type(m).__name__}; takes False with outer='limits', as a free joint has no range"
            )
    module.check(grid_size, floor_sizes[0])
    check_room(modules, grid_size, floor_sizes[0])
    if isinstance(module, Placed):
        check_anchors(module, before)
        check_rooms(module, before)
        check_separation(module, before, floor_sizes[1])
        check_places(module, before, grid_size, floor_sizes)


def check_room(modules: Sequence[Module], grid_size: int, floor_size: float) -> None:
    """Refuses more objects than the floor can hold when they are placed at random.

    Raises:
        ValueError: too many objects; the message has the free cells, the largest footprint and how many of it fit.
    """
    cell = floor_size / grid_size
    footprints = [(m, footprint_of(extent, cell)) for m in modules for extent in m.extents]
    if not footprints:
        return
    _check_quadrant(modules, grid_size, cell)
    module, (width, height) = max(footprints, key=lambda f: f[1][0] * f[1][1])
    free = grid_size**2 - sum(m.wall_cells(grid_size) for m in modules)
    room = int(JAMMING * free / (width * height))
    if max(width, height) > grid_size:
        raise ValueError(
            f"{_plural(module)}: got an object of {width} x {height} cells; "
            f"the floor takes up to {grid_size} x {grid_size}"
        )
    if sum(w * h for _, (w, h) in footprints) > JAMMING * free:
        module = max(modules, key=lambda m: sum(w * h for owner, (w, h) in footprints if owner is m))
        counts = ", ".join(f"{len(m.extents)} {_plural(m)}" for m in modules if m.extents)
        raise ValueError(
            f"n_{_plural(module)}: got {len(footprints)} objects in all ({counts}); the floor takes {room}: {free} "
            f"free cells over a largest footprint of {width} x {height} cells, of which random placement fills "
            f"{JAMMING:.0%}"
        )


def _plural(module: Module) -> str:
    return module.plural if isinstance(module, Placed) else module.name


def _check_quadrant(modules: Sequence[Module], grid_size: int, cell: float) -> None:
    # Without a quadrant in the world, placement in the quadrant means anywhere.
    cells = min((m.quadrant_cells(grid_size) for m in modules if m.provides_quadrant), default=grid_size**2)
    inside = [
        (m, footprint_of(extent, cell))
        for m in modules
        if isinstance(m, Placed)
        for extent, fn in zip(m.extents, m.placement_fns, strict=True)
        if getattr(fn, "inside_quadrant", False)
    ]
    taken = sum(width * depth for _, (width, depth) in inside)
    if taken > JAMMING * cells:
        counts = ", ".join(f"{n} {kind}" for kind, n in Counter(_plural(m) for m, _ in inside).items())
        raise ValueError(
            f"placement_fn: got {len(inside)} objects ({counts}) of {taken} cells in the quadrant; the smallest takes "
            f"{int(JAMMING * cells)}: of its {cells} cells random placement fills {JAMMING:.0%}"
        )
