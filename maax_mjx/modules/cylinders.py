"""Cylinders, movable or fixed to the floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.checks import check_bool
from maax_mjx.common.observed import POSITION, SIZE, Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World, uniform_placement
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.from_model import from_model
from maax_mjx.modules.module import BELOW
from maax_mjx.modules.placed import Placed, Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.physics.overlay import BOX_FIELDS, SIZE_FIELDS, cylinder_inertia, mass_rows, set_cylinders, set_masses
from maax_mjx.worldgen import Floor, Geom

MASS = 1.0
"""Kilograms."""


class CylinderSize:
    """Diameter and height of upright cylinders.

    Args:
        kind: kind of entity; the parameters are `<kind>_diameter` and `<kind>_height`.
        diameter: metres, or a range.
        height: metres, or a range.

    Raises:
        ValueError: a size that is not positive.
    """

    def __init__(self, kind: str, diameter: float | tuple[float, float], height: float | tuple[float, float]):
        self.diameter = Ranged(f"{kind}_diameter", diameter, above=True, argument="diameter")
        self.height = Ranged(f"{kind}_height", height, above=True, argument="height")

    @property
    def ranges(self) -> list[Ranged]:
        """The diameter and the height."""
        return [self.diameter, self.height]

    @property
    def varies(self) -> bool:
        """Whether worlds differ in the size."""
        return self.diameter.varies or self.height.varies

    @property
    def largest(self) -> np.ndarray:
        """Largest extents (3,) in metres."""
        return np.array([self.diameter.high, self.diameter.high, self.height.high], np.float32)

    def make(self, name: str, friction: float | None = None) -> Geom:
        """Returns a cylinder of the largest size."""
        size = (self.diameter.high, self.height.high)
        return Geom("cylinder", size, name=name, mass=MASS, friction=friction, rgba=(0.55, 0.45, 0.7, 1.0))

    def draw(self, draw: Callable[[Ranged], jax.Array]) -> jax.Array:
        """Returns extents (n, 3) in metres, where `draw` gives (n,) numbers of a range."""
        diameter, height = draw(self.diameter), draw(self.height)
        return jnp.stack([diameter, diameter, height], axis=1)


class Cylinders(Entities):
    """Upright cylinders of 1 kg that agents can push.

    MJX's own JAX physics has no contacts between a cylinder and a box, a wall or a ramp. `impl="jax"` refuses a
    cylinder together with any of these; `warp` and `c` accept it.

    Args:
        n: number per world, or (low, high); drawn uniformly.
        diameter: metres, or a range.
        height: metres, or a range.
        placement_fn: one function for all, or a list with one per slot.
        friction: sliding friction, or a range; None keeps MuJoCo's default of 1.
        per_object: whether every cylinder draws its own values from ranges; otherwise all of a world share one draw, as
            in OpenAI's games.

    Raises:
        ValueError: a negative or reversed count, or a size that is not positive.
    """

    kind = "cylinder"
    is_round = True

    def __init__(
        self,
        n: int | tuple[int, int] = 1,
        diameter: float | tuple[float, float] = 0.5,
        height: float | tuple[float, float] = 0.5,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        friction: float | tuple[float, float] | None = None,
        per_object: bool = True,
    ):
        self.size = CylinderSize(self.kind, diameter, height)
        super().__init__(n, self.size.largest.tolist(), placement_fn, friction=friction, per_object=per_object)

    @property
    def sizes_vary(self) -> bool:
        return bool(self.n_max) and self.size.varies

    @property
    def ranges(self) -> list[Ranged]:
        return [*super().ranges, *self.size.ranges]

    @property
    def overlay(self) -> Overlay:
        if not self.sizes_vary:
            return super().overlay
        sizes = dict.fromkeys(SIZE_FIELDS, self.geom_ids)
        return super().overlay | sizes | mass_rows(self.body_ids, self.qvel_ids)

    def make(self, name: str) -> Geom:
        return self.size.make(name)

    def draw_extents(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        return self.size.draw(lambda ranged: self.draw(ranged, key, params))

    def draw_fields(self, key: jax.Array, fields: Fields, params: DomainParams, places: Places) -> Fields:
        fields = super().draw_fields(key, fields, params, places)
        if not self.sizes_vary:
            return fields
        fields = set_cylinders(fields, self.geom_ids, places.extents / 2)
        mass = jnp.full(self.n_max, MASS)
        return set_masses(fields, self.body_ids, self.qvel_ids, mass, cylinder_inertia(mass, places.extents))

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Adds `cylinder_size` (n_max, 3), if worlds differ in it: diameter, diameter and height in metres."""
        return super().observation_step(world, data) | _observed_size(self, world)

    def declared(self) -> dict[str, Observed]:
        return super().declared() | _declared_size(self)


class StaticCylinders(Placed):
    """Upright cylinders that are fixed to the floor where they are placed (OpenAI's shelter game protects one).

    MJX's own JAX physics has no contacts between a cylinder and a box or a ramp. `impl="jax"` refuses a cylinder
    together with any of these; `warp` and `c` accept it.

    Args:
        n: number per world, or (low, high); drawn uniformly.
        diameter: metres, or a range.
        height: metres, or a range.
        placement_fn: one function for all, or a list with one per slot.
        friction: sliding friction, or a range; None keeps MuJoCo's default of 1.
        per_object: whether every cylinder draws its own values from ranges; otherwise all of a world share one draw, as
            in OpenAI's games.

    Raises:
        ValueError: a negative or reversed count, or a size that is not positive.
    """

    kind = "static_cylinder"
    is_round = True

    def __init__(
        self,
        n: int | tuple[int, int] = 1,
        diameter: float | tuple[float, float] = 0.5,
        height: float | tuple[float, float] = 0.5,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        friction: float | tuple[float, float] | None = None,
        per_object: bool = True,
    ):
        super().__init__(n, placement_fn)
        self.size = CylinderSize(self.kind, diameter, height)
        self.extent = self.size.largest
        self.friction = None if friction is None else Ranged(f"{self.kind}_friction", friction, argument="friction")
        self.per_object = check_bool("per_object", per_object)

    @property
    def sizes_vary(self) -> bool:
        return bool(self.n_max) and self.size.varies

    @property
    def parameters(self) -> list[Parameter]:
        ranges = self.size.ranges if self.friction is None else [self.friction, *self.size.ranges]
        return super().parameters + [p for ranged in ranges for p in ranged.parameters]

    @property
    def overlay(self) -> Overlay:
        frictions = self.friction is not None and self.friction.varies
        return dict.fromkeys(BOX_FIELDS + ("geom_friction",) * frictions, self.geom_ids)

    @property
    def contact_points(self) -> float:
        return Entities.contacts_each * self.n_max

    @from_model
    def geom_ids(self) -> np.ndarray:
        """Geom ids (n_max,)."""
        return np.array([self.model.geom(name).id for name in self.names], int)

    def build_step(self, floor: Floor, grid_size: int) -> None:
        friction = self.friction.high if self.friction else None
        for name in self.names:
            floor.append(self.size.make(name, friction).mark_static(), "parking", (0.5, 0.5))

    def draw(self, ranged: Ranged, key: jax.Array, params: DomainParams) -> jax.Array:
        """Draws (n_max,) values of a number or range."""
        return ranged.draw(key, params, self.n_max, shared=not self.per_object)

    def draw_extents(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        return self.size.draw(lambda ranged: self.draw(ranged, key, params))

    def write(self, key: jax.Array, layout: Layout, params: DomainParams, places: Places) -> Layout:
        height = jnp.where(places.active, places.extents[:, 2] / 2, BELOW)
        position = jnp.concatenate([places.centre, height[:, None]], axis=1)
        fields = set_cylinders(layout.fields, self.geom_ids, places.extents / 2)
        fields["geom_pos"] = with_rows(fields["geom_pos"], self.geom_ids, position)
        if self.friction is not None and self.friction.varies:
            sliding = self.draw(self.friction, key, params)
            fields["geom_friction"] = fields["geom_friction"].at[self.geom_ids, 0].set(sliding)
        return layout.replace(fields=fields)

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns `static_cylinder_pos` (n_max, 3), centres in metres, and `static_cylinder_mask` (n_max,).

        If worlds differ in size, also `static_cylinder_size` (n_max, 3): diameter, diameter and height in metres.
        Absent cylinders are zero.
        """
        if not self.n_max:
            return {}
        active = world.active[self.kind]
        position = jnp.where(active[:, None], data.geom_xpos[self.geom_ids], 0.0)
        obs = {"static_cylinder_pos": position, "static_cylinder_mask": active}
        return obs | _observed_size(self, world)

    def declared(self) -> dict[str, Observed]:
        if not self.n_max:
            return {}
        places = {f"{self.kind}_pos": Observed((self.kind,), POSITION), f"{self.kind}_mask": Observed((self.kind,))}
        return places | _declared_size(self)


def _declared_size(module: Cylinders | StaticCylinders) -> dict[str, Observed]:
    return {f"{module.kind}_size": Observed((module.kind,), SIZE)} if module.sizes_vary else {}


def _observed_size(module: Cylinders | StaticCylinders, world: World) -> dict[str, jax.Array]:
    """Returns `<kind>_size` (n_max, 3) in metres, if worlds differ in it; absent cylinders are zero."""
    if not module.sizes_vary:
        return {}
    active = world.active[module.kind]
    return {f"{module.kind}_size": jnp.where(active[:, None], module.extents_of(world), 0.0)}
