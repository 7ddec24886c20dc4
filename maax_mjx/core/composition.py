"""Whether a module fits what an environment has so far."""

from __future__ import annotations

from collections.abc import Sequence

from maax_mjx.core.capacity import check_room
from maax_mjx.modules import Agents, Entities, Module


def check_module(module: Module, before: Sequence[Module], n_agents: int, grid_size: int, floor_size: float) -> None:
    """Refuses a module that does not fit.

    Args:
        module: what is to be added.
        before: what was added already.
        n_agents: of the environment.
        grid_size: cells per side.
        floor_size: the smallest edge of the floor in metres.

    Raises:
        ValueError: naming the argument.
    """
    if module.name in [m.name for m in before]:
        raise ValueError(f"module: got a second {module.name!r}; takes one of each, by name")
    if isinstance(module, Agents) and module.n_max != n_agents:
        raise ValueError(f"n_agents: Base got {n_agents}, Agents got {module.n_max}; both take the same number")
    if module.requires_quadrant and not any(m.provides_quadrant for m in before):
        raise ValueError(
            f"placement_fn: {type(module).__name__} places by the quadrant and there is none; "
            'add WallScenarios(scenario="quad") before it'
        )
    if module.wall_cells(grid_size) and any(m.extents for m in before):
        raise ValueError(f"module: {type(module).__name__} comes after what it would be built over; add walls first")
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
            raise ValueError(f"free: {type(m).__name__} got True; a free joint has no range for outer='limits'")
    module.check(grid_size, floor_size)
    check_room(modules, grid_size, floor_size)
