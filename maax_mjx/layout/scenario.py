"""What a room scenario is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import described
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout.rooms import Rooms
from maax_mjx.layout.walls import Walls

Cells = Callable[[int], int]
"""Cells, as a function of how many the grid has per side."""


class Scenario(Protocol):
    """A kind of room plan: how one is drawn, and what is known of all of them before. A value, which can be hashed."""

    def __hash__(self) -> int: ...

    @property
    def n_walls(self) -> int:
        """How many inner walls its `Rooms` hold, absent ones included."""

    @property
    def n_rooms(self) -> int:
        """How many rooms its `Rooms` hold, absent ones included."""

    @property
    def shortest_wall(self) -> Cells | None:
        """Cells of the shortest stretch of a wall between two others, theirs included; None is not known."""

    @property
    def narrowest_room(self) -> Cells | None:
        """Cells across its narrowest room, the walls on both sides included; None is not known."""

    @property
    def wall_cells(self) -> Cells:
        """How many cells its walls take, at the most."""

    @property
    def quadrant_cells(self) -> Cells | None:
        """How many cells its quadrant has, at the least; None has no quadrant."""

    @property
    def fixed_doors(self) -> bool:
        """Whether every one of its walls is there and has a door, in every world."""

    @property
    def fixed_walls(self) -> bool:
        """Whether its walls stand at the same places in every world."""

    @property
    def tries(self) -> int:
        """How often its rooms are drawn until they are valid, before everything else is drawn again, too."""

    @property
    def parameters(self) -> list[Parameter]:
        """What of it can be randomised."""

    def sized(self, n_rooms: tuple[int, int], min_room_size: int) -> Scenario:
        """The scenario with what an environment asks of numbers and sizes of rooms, if these can be asked of it."""

    def check(self, grid_size: int) -> None:
        """Refuses a grid that is too small.

        Raises:
            ValueError: naming the argument of `WallScenarios`.
        """

    def draw(self, key: jax.Array, count_key: jax.Array, grid_size: int, params: DomainParams) -> Rooms:
        """The rooms of one world, without doors.

        Args:
            key: another one whenever the rooms are drawn again.
            count_key: the same one then, for what of them is counted.
            grid_size: cells per side.
            params: the ranges of its `parameters`, among others.
        """


@dataclass(frozen=True)
class FixedScenario:
    """A scenario with a fixed number of walls and rooms; see `register_scenario`."""

    name: str
    draw_rooms: Callable[[jax.Array, int], Rooms]
    n_walls: int
    n_rooms: int
    shortest_wall: Cells | None
    narrowest_room: Cells | None
    wall_cells: Cells
    quadrant_cells: Cells | None
    fixed_doors: bool
    fixed_walls: bool
    tries = 1

    @property
    def parameters(self) -> list[Parameter]:
        """None."""
        return []

    def sized(self, n_rooms: tuple[int, int], min_room_size: int) -> FixedScenario:
        """The scenario itself, which has its own numbers."""
        return self

    def check(self, grid_size: int) -> None:
        """Nothing: it takes every grid."""

    def draw(self, key: jax.Array, count_key: jax.Array, grid_size: int, params: DomainParams) -> Rooms:
        """The rooms of one world.

        Raises:
            ValueError: what was registered returns something else than it was registered with.
        """
        rooms = self.draw_rooms(key, grid_size)
        returned = f"draw: that of scenario {self.name!r} returned"
        if not isinstance(rooms, Rooms):
            raise ValueError(f"{returned} {described(rooms)}; takes Rooms")
        none = [0] * self.n_walls
        takes = Rooms.create(Walls.create(none, none, none, none), [[0] * 4] * self.n_rooms)
        wanted, drawn = jax.tree_util.tree_leaves_with_path(takes), jax.tree.leaves(rooms)
        if len(drawn) != len(wanted):
            raise ValueError(f"{returned} Rooms of something else than arrays; takes them from Rooms.create")
        for (path, want), got in zip(wanted, drawn, strict=True):
            if (jnp.shape(got), jnp.result_type(got)) != (want.shape, want.dtype):
                raise ValueError(
                    f"{returned} {jax.tree_util.keystr(path).lstrip('.')} of shape {jnp.shape(got)} and type "
                    f"{jnp.result_type(got)}; takes {want.shape} and {want.dtype}, for n_walls={self.n_walls} and "
                    f"n_rooms={self.n_rooms}"
                )
        return rooms
