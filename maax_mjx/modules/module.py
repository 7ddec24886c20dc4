"""The interface of a module: four phases, two on the host and two on the device."""

from __future__ import annotations

from typing import ClassVar

import jax
import mujoco

from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, World
from maax_mjx.physics import Data, Overlay
from maax_mjx.worldgen import Floor

BELOW = -10.0
"""Height of what is absent and cannot be moved, in metres: deep below the floor."""


class Module:
    """A part of a world. Subclass it for your own; every hook has a default that adds nothing.

    Attributes:
        name: unique within an environment; it seeds the module's draws, so that modules stay independent.
        provides_quadrant: whether the module's room plan has a quadrant.
        limits_arena: whether the joints of what can move are to end at the edge of the floor.
    """

    name: ClassVar[str]
    provides_quadrant: bool = False
    requires_quadrant: bool = False
    limits_arena: bool = False

    @property
    def parameters(self) -> list[Parameter]:
        """The randomisation parameters that this module adds to `DomainParams`."""
        return []

    @property
    def overlay(self) -> Overlay:
        """The rows of model fields that `layout_step` sets; after `cache_step`."""
        return {}

    @property
    def idle_equalities(self) -> int:
        """How many of its equalities are never active together with the others: no engine makes room for them."""
        return 0

    @property
    def contact_points(self) -> float:
        """How many contact points its entities need in a jam, for the engines' capacities."""
        return 0

    @property
    def extents(self) -> list[tuple[float, float]]:
        """(x, y) extents in metres of every object that it places, at the maximum."""
        return []

    def wall_cells(self, grid_size: int) -> int:
        """How many cells its walls take, at the most."""
        return 0

    def quadrant_cells(self, grid_size: int) -> int:
        """How many cells its quadrant has, at the least."""
        return 0

    def check(self, grid_size: int, floor_size: float) -> None:
        """Refuses arguments that do not fit the floor, of at least `floor_size` metres.

        Raises:
            ValueError: naming the argument.
        """

    def build_step(self, floor: Floor, grid_size: int) -> None:
        """Host: appends the largest number of everything to the floor."""

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        """Host: changes the spec that the tree became, before it is compiled."""

    def cache_step(self, model: mujoco.MjModel) -> None:
        """Host: resolves names to ids, once."""

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        """Device: draws and places. Counts depend on `key` alone, places on `layout.attempt` too."""
        return layout

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Device: this module's observations by name."""
        return {}
