"""Boxes and ramps."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.annotated import NonNegative, check_value
from maax_mjx.common.checks import check_bool
from maax_mjx.common.observed import POSITION, SIZE, TURN, YAW, Column
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import PlacementFn, World, uniform_placement
from maax_mjx.modules.elongated import Elongated
from maax_mjx.modules.entities import Entities
from maax_mjx.modules.placed import Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.physics.overlay import SIZE_FIELDS, box_inertia, mass_rows, set_boxes, set_masses
from maax_mjx.worldgen import Geom, Obj, Wedge

RAMP_SIZE = 0.5
"""Metres."""
RAMP_MASS = 1.0
"""Kilograms."""


class Boxes(Entities):
    """Cubes, and elongated boxes (3.3 times as long, 0.3 times as wide, along x or y), that agents can push.

    The elongated boxes of a world come first, and those along x first among them. Numbers are drawn by OpenAI's rule:
    all boxes from `n_boxes`, the elongated ones from `n_elongated_boxes`, at most all boxes, and any number of these
    along x.

    Args:
        n_boxes: number per world, or (low, high); drawn uniformly.
        n_elongated_boxes: number of elongated boxes, or (low, high).
        placement_fn: one function for all, or a list with one per slot.
        box_size: edge length in metres, or a range.
        box_mass: kg, or a range, independent of the size. Inertia depends on both.
        box_friction: sliding friction, or a range; None keeps MuJoCo's default of 1. MuJoCo uses the larger one of two
            geoms in contact.
        free: whether boxes have a free joint instead of slides x, y, z and a yaw hinge.
        box_only_z_rot: OpenAI's argument; False lets boxes turn about all axes, the same as `free=True`.
        random_yaw: whether each starts at a uniformly random yaw.
        per_object: whether every box draws its own size, mass and friction; otherwise all of a world share one draw.
        boxid_obs: whether `box_obs` has a column with the box's index.
        boxsize_obs: whether `box_obs` has three columns with the box's extents; None adds them if worlds differ in
            them.
        polar_obs: whether `box_obs` has cos and sin of the yaw instead of the yaw itself; free boxes have neither.
        damping: of all joints, in N s/m and Nm s/rad.

    Raises:
        ValueError: a negative or reversed count, a negative damping, or a size or mass that is not positive.
    """

    kind = "box"
    count_name = "n_boxes"
    friction_argument = "box_friction"

    def __init__(
        self,
        n_boxes: int | tuple[int, int] = 1,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        box_size: float | tuple[float, float] = 0.5,
        box_friction: float | tuple[float, float] | None = None,
        free: bool = False,
        random_yaw: bool = False,
        *,
        n_elongated_boxes: int | tuple[int, int] = 0,
        box_mass: float | tuple[float, float] = 1.0,
        box_only_z_rot: bool = True,
        per_object: bool = True,
        boxid_obs: bool = False,
        boxsize_obs: bool | None = None,
        polar_obs: bool = True,
        damping: float = 0.01,
    ):
        self.damping = float(check_value("damping", damping, NonNegative))
        self.size = Ranged("box_size", box_size, above=True)
        self.mass = Ranged("box_mass", box_mass, above=True)
        free = check_bool("free", free) or not check_bool("box_only_z_rot", box_only_z_rot)
        super().__init__(
            n_boxes,
            [self.size.high] * 3,
            placement_fn,
            friction=box_friction,
            free=free,
            random_yaw=random_yaw,
            per_object=per_object,
        )
        self.elongated = Elongated("n_elongated_boxes", n_elongated_boxes, self.n_max)
        self.boxid_obs = check_bool("boxid_obs", boxid_obs)
        self.polar_obs = check_bool("polar_obs", polar_obs) or free
        self.boxsize_obs = self.sizes_vary if boxsize_obs is None else check_bool("boxsize_obs", boxsize_obs)

    @property
    def sizes_vary(self) -> bool:
        return bool(self.n_max) and (self.size.varies or self.elongated.possible)

    @property
    def ranges(self) -> list[Ranged]:
        return [*super().ranges, self.size, self.mass]

    @property
    def parameters(self) -> list[Parameter]:
        return super().parameters + self.elongated.parameters

    @property
    def overlay(self) -> Overlay:
        overlay = super().overlay
        if self.sizes_vary:
            overlay |= dict.fromkeys(SIZE_FIELDS, self.geom_ids)
        if self.sizes_vary or self.mass.varies:
            overlay |= mass_rows(self.body_ids, self.qvel_ids)
        return overlay

    @property
    def largest(self) -> np.ndarray:
        return self.elongated.largest(self.extent)

    def make(self, name: str) -> Obj:
        size = [float(e) for e in self.extent]
        rgba = (0.80, 0.71, 0.55, 1.0)
        return Geom("box", size, name=name, mass=self.mass.high, free=self.free, rgba=rgba, damping=self.damping)

    def draw_extents(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        return self.draw(self.size, key, params)[:, None] * self.elongated.draw(key, params, wanted)

    def draw_fields(self, key: jax.Array, fields: Fields, params: DomainParams, places: Places) -> Fields:
        fields = super().draw_fields(key, fields, params, places)
        if self.sizes_vary:
            fields = set_boxes(fields, self.geom_ids, places.extents / 2)
        if self.sizes_vary or self.mass.varies:
            mass = self.draw(self.mass, key, params)
            inertia = box_inertia(mass, places.extents)
            fields = set_masses(fields, self.body_ids, self.qvel_ids, mass, inertia)
        return fields

    def declared_columns(self) -> tuple[Column, ...]:
        columns = super().declared_columns()
        if not self.polar_obs:
            columns = (*POSITION, *YAW, *columns[len(POSITION) + len(TURN) :])
        columns += (Column("index"),) if self.boxid_obs else ()
        return (*columns, *SIZE) if self.boxsize_obs else columns

    def observation_columns(self, world: World, data: Data) -> list[jax.Array]:
        """Adds to the columns of `Entities` index and extents, if asked for; without `polar_obs` yaw is one column."""
        position, turn, velocity, *inside = super().observation_columns(world, data)
        if not self.polar_obs:
            turn = data.qpos[self.qpos_ids[:, 3:]]
        columns = [position, turn, velocity, *inside]
        if self.boxid_obs:
            columns.append(jnp.arange(self.n_max, dtype=velocity.dtype)[:, None])
        return [*columns, self.extents_of(world)] if self.boxsize_obs else columns


class Ramps(Entities):
    """Wedges of 0.5 m that rise at 45 degrees towards their -y edge.

    Args:
        n_ramps: number per world, or (low, high); drawn uniformly.
        placement_fn: one function for all, or a list with one per slot.
        ramp_friction: sliding friction, or a range; None keeps MuJoCo's default of 1.
        free: whether ramps have a free joint instead of slides x, y, z and a yaw hinge.
        random_yaw: whether each starts at a uniformly random yaw.
        per_object: whether every ramp draws its own friction; otherwise all of a world share one draw.
        inertial_reach: whether agents reach for the box with the axes of the wedge's inertia, as in the published code,
            0.47 m by 0.5 m by 0.71 m, instead of the box around it.
        damping: of all joints, in N s/m and Nm s/rad.

    Raises:
        ValueError: a negative or reversed count, or a negative damping.
    """

    kind = "ramp"
    friction_argument = "ramp_friction"

    def __init__(
        self,
        n_ramps: int | tuple[int, int] = 1,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        ramp_friction: float | tuple[float, float] | None = None,
        free: bool = False,
        random_yaw: bool = False,
        per_object: bool = True,
        inertial_reach: bool = False,
        damping: float = 0.1,
    ):
        self.damping = float(check_value("damping", damping, NonNegative))
        self.inertial_reach = check_bool("inertial_reach", inertial_reach)
        super().__init__(
            n_ramps,
            [RAMP_SIZE] * 3,
            placement_fn,
            friction=ramp_friction,
            free=free,
            random_yaw=random_yaw,
            per_object=per_object,
        )

    def make(self, name: str) -> Obj:
        return Wedge(RAMP_SIZE, name, mass=RAMP_MASS, free=self.free, damping=self.damping)

    def reach_of(self, world: World) -> jax.Array:
        if not self.inertial_reach:
            return super().reach_of(world)
        # MuJoCo sizes a mesh's geom by its inertia.
        return 2 * jnp.asarray(self.model.geom_size[self.geom_ids], float)
