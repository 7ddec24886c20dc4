"""Cylinders, to push or to walk around."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.params import DomainParams
from maax_mjx.layout import Layout, PlacementFn, World, uniform_placement
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.module import BELOW
from maax_mjx.modules.placed import Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.physics.overlay import BOX_FIELDS, SIZE_FIELDS, cylinder_inertia, mass_rows, set_cylinders, set_masses
from maax_mjx.worldgen import Floor, Geom, Obj

MASS = 1.0


class Cylinders(Entities):
    """Upright cylinders of 1 kg, movable or fixed to the floor (OpenAI's shelter game protects a fixed one).

    MJX's own JAX physics has no contacts between a cylinder and a box, a wall or a ramp; `impl="jax"` refuses a
    movable one beside any of these, and a fixed one beside a box or a ramp, `warp` and `c` take it.

    Args:
        n: how many per world, or (low, high); drawn uniformly.
        diameter: metres, or a range.
        height: metres, or a range.
        static: whether they are fixed where they are placed.
        placement_fn: one function for all, or a list with one per slot.
        friction: sliding friction, or a range; None keeps MuJoCo's default of 1.
        per_object: whether every cylinder draws its own from the ranges, or all of a world share one draw, as OpenAI's.

    Raises:
        ValueError: a negative or reversed count, or a size that is not positive.
    """

    name = "cylinders"
    kind = "cylinder"
    count_name = "n_cylinders"
    friction_name = "cylinder_friction"
    is_round = True

    def __init__(
        self,
        n: int | tuple[int, int] = 1,
        diameter: float | tuple[float, float] = 0.5,
        height: float | tuple[float, float] = 0.5,
        static: bool = False,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        friction: float | tuple[float, float] | None = None,
        per_object: bool = True,
    ):
        self.diameter = Ranged("cylinder_diameter", diameter, above=True, argument="diameter")
        self.height = Ranged("cylinder_height", height, above=True, argument="height")
        extent = (self.diameter.high, self.diameter.high, self.height.high)
        super().__init__(n, extent, placement_fn, friction=friction, per_object=per_object)
        self.static = static

    @property
    def sizes_vary(self) -> bool:
        return bool(self.n_max) and (self.diameter.varies or self.height.varies)

    @property
    def ranges(self) -> list[Ranged]:
        return [*super().ranges, self.diameter, self.height]

    @property
    def overlay(self) -> Overlay:
        if self.static:
            return self.friction_rows | dict.fromkeys(BOX_FIELDS, self.geom_ids)
        if not self.sizes_vary:
            return super().overlay
        sizes = dict.fromkeys(SIZE_FIELDS, self.geom_ids)
        return super().overlay | sizes | mass_rows(self.body_ids, self.qvel_ids)

    def make(self, name: str) -> Obj:
        rgba = (0.55, 0.45, 0.7, 1.0)
        size = (self.diameter.high, self.height.high)
        return Geom("cylinder", size, name=name, mass=MASS, rgba=rgba)

    def build_step(self, floor: Floor, grid_size: int) -> None:
        if not self.static:
            return super().build_step(floor, grid_size)
        for name in self.names:
            floor.append(self.make(name).mark_static(), "parking", (0.5, 0.5))
        return None

    def cache_step(self, model: mujoco.MjModel) -> None:
        if not self.static:
            return super().cache_step(model)
        self.geom_ids = self.all_geom_ids = np.array([model.geom(name).id for name in self.names], int)
        self.slot_of_geom = np.arange(self.n_max)
        return None

    def geoms_of(self, spec: mujoco.MjSpec, name: str) -> list[mujoco.MjsGeom]:
        return [spec.geom(name)] if self.static else super().geoms_of(spec, name)

    def draw_extents(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        diameter, height = self.draw(self.diameter, key, params), self.draw(self.height, key, params)
        return jnp.stack([diameter, diameter, height], axis=1)

    def write(self, key: jax.Array, layout: Layout, params: DomainParams, places: Places) -> Layout:
        if not self.static:
            return super().write(key, layout, params, places)
        height = jnp.where(places.active, places.extents[:, 2] / 2, BELOW)
        pos = jnp.concatenate([places.centre, height[:, None]], axis=1)
        fields = layout.fields | {"geom_pos": with_rows(layout.fields["geom_pos"], self.geom_ids, pos)}
        return layout.replace(fields=self.draw_fields(key, fields, params, places))

    def draw_fields(self, key: jax.Array, fields: Fields, params: DomainParams, places: Places) -> Fields:
        fields = super().draw_fields(key, fields, params, places)
        if self.sizes_vary or self.static:
            fields = set_cylinders(fields, self.geom_ids, places.extents / 2)
        if self.sizes_vary and not self.static:
            mass = jnp.full(self.n_max, MASS)
            inertia = cylinder_inertia(mass, places.extents)
            fields = set_masses(fields, self.body_ids, self.qvel_ids, mass, inertia)
        return fields

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """As of `Entities`; of static ones `static_cylinder_pos` (n_max, 3) instead. Diameter, diameter and height
        (n_max, 3) in `cylinder_size` where worlds differ in them.
        """
        if not self.n_max:
            return {}
        active = world.active[self.kind]
        if self.static:
            obs = {"static_cylinder_pos": data.geom_xpos[self.geom_ids], "static_cylinder_mask": active}
        else:
            obs = super().observation_step(world, data)
        if self.sizes_vary:
            obs["cylinder_size"] = self.extents_of(world)
        return {name: jnp.where(active[:, None], x, 0.0) if x.ndim == 2 else x for name, x in obs.items()}
