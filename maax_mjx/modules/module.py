"""The interface of a module: what it adds to the model on the host, and to every world on the device."""

from __future__ import annotations

import copy
from typing import Any, Protocol

import jax
import mujoco

from maax_mjx.common.observed import Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, World
from maax_mjx.modules.from_model import without_worked_out
from maax_mjx.physics import Data, Overlay
from maax_mjx.worldgen import Floor

BELOW = -10.0
"""Height of what is absent and cannot be moved, in metres: deep below the floor."""


class Owner(Protocol):
    """What modules are added to: `Base`."""

    @property
    def build(self) -> object: ...
    @property
    def model(self) -> mujoco.MjModel: ...


class Module:
    """A part of a world. Subclass it for your own; every hook has a default that adds nothing.

    Attributes:
        name: unique within an environment; it seeds the module's draws, so that modules stay independent.
        provides_quadrant: whether the module's room plan has a quadrant.
        requires_quadrant: whether it places things by the quadrant.
        limits_arena: whether the joints of what can move are to end at the edge of the floor.
    """

    name: str
    provides_quadrant: bool = False
    requires_quadrant: bool = False
    limits_arena: bool = False
    _owner: Owner | None = None

    @property
    def owner(self) -> Owner:
        """The environment that this module was added to.

        Raises:
            RuntimeError: none yet.
        """
        if self._owner is None:
            mine = type(self).__name__
            raise RuntimeError(f"{mine}: is in no environment yet; add it to one first: env.add_module({mine}(...))")
        return self._owner

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model that this module is in; reading it builds the environment.

        Raises:
            RuntimeError: the module is in no environment yet.
        """
        return self.owner.model

    @property
    def build(self) -> object:
        """What stands for the composition that `from_model` properties belong to."""
        return self.owner.build

    def __deepcopy__(self, memo: dict[int, Any]) -> Module:
        """A copy that belongs to the copy of its environment, or to none."""
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        for name, value in without_worked_out(vars(self)).items():
            if name != "_owner":
                setattr(twin, name, copy.deepcopy(value, memo))
        twin._owner = memo.get(id(self._owner))
        return twin

    @property
    def parameters(self) -> list[Parameter]:
        """The randomisation parameters that this module adds to `DomainParams`."""
        return []

    @property
    def overlay(self) -> Overlay:
        """The rows of model fields that `layout_step` sets."""
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

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        """Device: draws and places. Counts depend on `key` alone, places on `layout.attempt` too."""
        return layout

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Device: this module's observations by name."""
        return {}

    def declared(self) -> dict[str, Observed]:
        """What the arrays of `observation_step` are: their axes and columns, and who sees them."""
        return {}
