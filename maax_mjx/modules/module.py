"""The interface of a module: what it adds to the model on the host, and to every world on the device."""

from __future__ import annotations

import copy
from typing import Any, Protocol

import jax
import mujoco
import numpy as np

from maax_mjx.common.observed import Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.common.recorded import Recorded
from maax_mjx.layout import Layout, World
from maax_mjx.modules.from_model import without_cached
from maax_mjx.physics import Data, Overlay
from maax_mjx.worldgen import Floor

BELOW = -10.0
"""Metres of height at which absent things without joints are put, deep below the floor."""


class Owner(Protocol):
    """The environment that modules are added to: `Base`."""

    @property
    def build(self) -> object: ...
    @property
    def model(self) -> mujoco.MjModel: ...


class Module(Recorded):
    """A part of a world. Subclass it for your own; every hook has a default that adds nothing.

    `docs/extending/modules.md` has an example and a table of the hooks.

    Attributes:
        name: name, unique within an environment; it seeds the module's draws, so that modules stay independent.
        provides_quadrant: whether the module's room plan has a quadrant.
        requires_quadrant: whether it places things by the quadrant.
        limits_arena: whether the joints of movable entities end at the edge of the floor.
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
            RuntimeError: the module is in no environment yet.
        """
        if self._owner is None:
            mine = type(self).__name__
            raise RuntimeError(f"{mine}: is in no environment yet; add it to one first: env.add_module({mine}(...))")
        return self._owner

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of the module's environment; reading it builds the environment.

        Raises:
            RuntimeError: the module is in no environment yet.
        """
        return self.owner.model

    @property
    def build(self) -> object:
        """The token of the composition that `from_model` properties belong to."""
        return self.owner.build

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.made_with})"

    def __reduce__(self) -> Any:
        return _again, (type(self), *self.made_with)

    def __deepcopy__(self, memo: dict[int, Any]) -> Module:
        """Copies the module, as a part of its environment's copy or of no environment."""
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        for name, value in without_cached(self).items():
            if name != "_owner":
                setattr(twin, name, copy.deepcopy(value, memo))
        twin._owner = memo.get(id(self._owner))
        return twin

    @property
    def parameters(self) -> list[Parameter]:
        """The randomisation parameters that the module adds to `DomainParams`."""
        return []

    @property
    def overlay(self) -> Overlay:
        """The rows of model fields that `layout_step` sets, by field; all others are the same in all worlds."""
        return {}

    @property
    def idle_equalities(self) -> int:
        """Number of its equalities that are never active together with the others: engines make no room for them."""
        return 0

    @property
    def contact_points(self) -> float:
        """Contact points that its entities need in a jam, for the engines' capacities."""
        return 0

    @property
    def extents(self) -> list[tuple[float, float]]:
        """Largest extents (x, y) in metres of every object that it places."""
        return []

    def wall_cells(self, grid_size: int) -> int:
        """Returns the largest number of cells that its walls take."""
        return 0

    def fixed_cells(self, grid_size: int) -> np.ndarray:
        """Returns the cells (G, G) bool that its walls take in every world."""
        return np.zeros((grid_size, grid_size), bool)

    def quadrant_cells(self, grid_size: int) -> int:
        """Returns the smallest number of cells of its quadrant."""
        return 0

    def check(self, grid_size: int, floor_size: float) -> None:
        """Refuses arguments that do not fit the smallest floor, of `floor_size` metres.

        Raises:
            ValueError: such an argument; the message names it.
        """

    def build_step(self, floor: Floor, grid_size: int) -> None:
        """Adds the largest number of everything to the floor, on the host."""

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        """Changes the spec before it is compiled, on the host."""

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        """Draws and places, on the device, and returns the layout, changed with `layout.replace`.

        Counts depend only on `key`, places also on `layout.attempt`. Fields are whole, as `layout.fields` has them.
        """
        return layout

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns the module's observations by name, on the device."""
        return {}

    def declared(self) -> dict[str, Observed]:
        """Returns the declarations of the arrays of `observation_step`."""
        return {}


def _again(kind: type[Module], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Module:
    """Makes a module anew, in no environment; for pickle."""
    return kind(*args, **kwargs)
