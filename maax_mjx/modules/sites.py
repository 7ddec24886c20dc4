"""Marks on the floor that nothing collides with: food and construction sites (OpenAI's games), bases of flags."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.checks import check_positive, check_range
from maax_mjx.common.observed import POSITION, Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World, uniform_placement
from maax_mjx.layout.grid import within
from maax_mjx.modules.elongated import Elongated
from maax_mjx.modules.module import BELOW
from maax_mjx.modules.placed import Placed, Places
from maax_mjx.physics import Data

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) / 2


class Sites(Placed):
    """Marks that have a place and a size, but no body.

    They occupy their cells, so that nothing else starts on them. A subclass sets `kind` and `rgba`.

    Args:
        count: number per world, or (low, high).
        extent: extents (x, y, z) in metres.
        placement_fn: one function for all, or a list with one per slot.
        height: height of their centres in metres.
    """

    rgba: tuple[float, float, float, float]
    site_type = mujoco.mjtGeom.mjGEOM_SPHERE

    def __init__(
        self,
        count: int | tuple[int, int],
        extent: Sequence[float],
        placement_fn: PlacementFn | Sequence[PlacementFn],
        height: float,
    ):
        super().__init__(count, placement_fn)
        rgba = np.asarray(getattr(self, "rgba", ()), float)
        if rgba.shape != (4,):
            got = repr(self.rgba) if hasattr(self, "rgba") else "none"
            raise ValueError(f"rgba: {type(self).__name__} has {got}; takes four numbers in [0, 1], set in the class")
        self.extent = np.asarray(extent, np.float32)
        if self.extent.shape != (3,) or not (self.extent > 0).all():
            raise ValueError(f"extent: got {extent!r}; takes three positive numbers, in metres")
        self.site_height = check_range("height", (height, height), -np.inf)[0]

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        for name in self.names:
            spec.worldbody.add_site(
                name=name, type=self.site_type, size=self.extent / 2, rgba=self.rgba, pos=(0, 0, BELOW)
            )

    def write(self, key: jax.Array, layout: Layout, params: DomainParams, places: Places) -> Layout:
        height = jnp.full((self.n_max, 1), self.site_height)
        pos = jnp.concatenate([places.centre, height], axis=1)
        pos = jnp.where(places.active[:, None], pos, 0.0)
        return layout.replace(sites=layout.sites | {self.kind: pos})

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns `<kind>_pos` (n_max, 3), centres in metres, and `<kind>_mask` (n_max,); absent marks are zero."""
        if not self.n_max:
            return {}
        return {f"{self.kind}_pos": world.sites[self.kind], f"{self.kind}_mask": world.active[self.kind]}

    def declared(self) -> dict[str, Observed]:
        if not self.n_max:
            return {}
        return {f"{self.kind}_pos": Observed((self.kind,), POSITION), f"{self.kind}_mask": Observed((self.kind,))}


class Food(Sites):
    """Pieces of food; eating them is up to the game's mechanics.

    Args:
        n_food: number of pieces per world, or (low, high); drawn uniformly.
        food_size: diameter in metres.
        placement_fn: one function for all, or a list with one per slot.

    Raises:
        ValueError: a negative or reversed count, or a size that is not positive.
    """

    kind = "food"
    count_name = "n_food"
    is_round = True
    rgba = (0.2, 0.7, 0.3, 1.0)

    def __init__(
        self,
        n_food: int | tuple[int, int] = 1,
        food_size: float = 0.1,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
    ):
        size = check_positive("food_size", food_size)
        super().__init__(n_food, [size] * 3, placement_fn, height=size / 2)


class ConstructionSites(Sites):
    """Target places for boxes, with their four corners (OpenAI's blueprint game).

    Elongated sites are 3.3 times as long and 0.3 times as wide, drawn like elongated boxes.

    Args:
        n_sites: number per world, or (low, high); drawn uniformly.
        site_size: edge in metres.
        site_height: height of centres and corners in metres.
        n_elongated_sites: number of elongated sites, or (low, high).
        placement_fn: one function for all, or a list with one per slot.

    Raises:
        ValueError: a negative or reversed count, or a size that is not positive.
    """

    kind = "construction_site"
    count_name = "n_sites"
    rgba = (0.9, 0.5, 0.1, 0.5)
    site_type = mujoco.mjtGeom.mjGEOM_BOX

    def __init__(
        self,
        n_sites: int | tuple[int, int] = 1,
        site_size: float = 0.5,
        site_height: float = 0.25,
        n_elongated_sites: int | tuple[int, int] = 0,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
    ):
        size, height = check_positive("site_size", site_size), check_positive("site_height", site_height)
        super().__init__(n_sites, [size] * 3, placement_fn, height=height)
        self.elongated = Elongated("n_elongated_sites", n_elongated_sites, self.n_max)

    @property
    def sizes_vary(self) -> bool:
        return self.elongated.possible

    @property
    def parameters(self) -> list[Parameter]:
        return super().parameters + self.elongated.parameters

    @property
    def largest(self) -> np.ndarray:
        return self.elongated.largest(self.extent)

    def draw_extents(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        return jnp.asarray(self.extent) * self.elongated.draw(key, params, wanted)

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Adds `construction_site_corner_pos` (n_max, 4, 3), in metres, to the observations of `Sites`."""
        if not self.n_max:
            return {}
        obs = super().observation_step(world, data)
        active = world.active[self.kind][:, None, None]
        return obs | {f"{self.kind}_corner_pos": jnp.where(active, self.corners(world), 0.0)}

    def corners(self, world: World) -> jax.Array:
        """Returns the four corners of every site: (n_max, 4, 3) metres; those of absent sites mean nothing."""
        flat = self.extents_of(world)[:, None, :2] * CORNERS
        return world.sites[self.kind][:, None] + jnp.pad(flat, ((0, 0), (0, 0), (0, 1)))

    def declared(self) -> dict[str, Observed]:
        corners = {f"{self.kind}_corner_pos": Observed((self.kind, "corner"), POSITION)} if self.n_max else {}
        return super().declared() | corners


class Flags(Sites):
    """The bases of two flags, the first team's and the second's.

    Args:
        placement_fn: one function for both, or a list with one for each; None puts the first into the half of low y
            and the second into that of high y, as `CaptureTheFlag` needs.
        base_size: diameter in metres.

    Raises:
        ValueError: a size that is not positive.
    """

    kind = "flag"
    is_round = True
    rgba = (0.94, 0.89, 0.26, 1.0)

    def __init__(self, placement_fn: PlacementFn | Sequence[PlacementFn] | None = None, base_size: float = 0.4):
        size = check_positive("base_size", base_size)
        placement_fn = [_low_half, _high_half] if placement_fn is None else placement_fn
        super().__init__(2, [size, size, 0.02], placement_fn, height=0.01)


def _low_half(layout: Layout, cells: jax.Array) -> jax.Array:
    g = layout.grid.size
    return within(g, cells, jnp.array([0, 0, g, g // 2]))


def _high_half(layout: Layout, cells: jax.Array) -> jax.Array:
    g = layout.grid.size
    return within(g, cells, jnp.array([0, -(-g // 2), g, g]))
