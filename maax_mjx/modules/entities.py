"""Movable things that a world holds a drawn number of: agents, boxes, ramps, cylinders."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World
from maax_mjx.modules.placed import Placed, Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.worldgen import Floor, Obj


class Entities(Placed):
    """A kind of movable object. Slots beyond the drawn count stay parked above the arena, weightless and masked.

    A subclass sets `name`, `kind` and `count_name`, and implements `make`.

    Attributes:
        rest_depth: how deep in the floor one starts, in metres, which is how deep a soft contact holds it under earth's
            gravity. Put down at exactly zero it would be in contact or fall by the last bit of a float, and no two
            engines would agree on its first steps.
        static: whether they are fixed to the floor; all others move.
        contacts_each: contact points of one in a jam, on MJX, which gives some points twice. In 128 worlds of M, jammed
            for 1,000 steps under full force at -50 m/s^2, the most were 23, of 31 that this makes.

    Args:
        count: how many per world, or (low, high).
        extent: (x, y, z) of one in metres, at the largest.
        placement_fn: where they go: one function for all, or a list with one for each slot.
        friction: sliding friction, or a range of it; None keeps MuJoCo's default of 1.
        free: whether `make` gives a free joint rather than slides x, y, z and a yaw hinge.
        random_yaw: whether each starts turned by a uniformly random angle; else all at yaw 0.
        per_object: whether every object draws its own from the ranges, or all of a world share one draw.
    """

    rest_depth = 1.08e-4
    contacts_each = 6.5
    static = False
    friction_name: str
    friction_argument = "friction"

    def __init__(
        self,
        count: int | tuple[int, int],
        extent: Sequence[float],
        placement_fn: PlacementFn | Sequence[PlacementFn],
        *,
        friction: float | tuple[float, float] | None = None,
        free: bool = False,
        random_yaw: bool = False,
        per_object: bool = True,
        minimum: int = 0,
    ):
        super().__init__(count, placement_fn, random_yaw=random_yaw, minimum=minimum)
        self.extent = np.asarray(extent, np.float32)
        self.friction = (
            None if friction is None else Ranged(self.friction_name, friction, argument=self.friction_argument)
        )
        self.free = free
        self.per_object = per_object

    def make(self, name: str) -> Obj:
        """A new object of this kind for the tree."""
        raise NotImplementedError

    @property
    def ranges(self) -> list[Ranged]:
        """What of these can be a range besides their number."""
        return [self.friction] if self.friction else []

    @property
    def parameters(self) -> list[Parameter]:
        return super().parameters + [p for ranged in self.ranges for p in ranged.parameters]

    @property
    def overlay(self) -> Overlay:
        return {"body_gravcomp": self.body_ids} | self.friction_rows

    @property
    def friction_rows(self) -> Overlay:
        """The rows of their friction, where it is drawn."""
        varies = self.friction is not None and self.friction.varies
        return {"geom_friction": self.all_geom_ids} if varies else {}

    @property
    def contact_points(self) -> float:
        return self.contacts_each * self.n_max

    def build_step(self, floor: Floor, grid_size: int) -> None:
        for name in self.names:
            floor.append(self.make(name), "parking", (0.5, 0.5))

    def spec_step(self, spec: mujoco.MjSpec) -> None:
        if self.friction is not None:
            for geom in [geom for name in self.names for geom in self.geoms_of(spec, name)]:
                geom.friction[0] = self.friction.high

    def geoms_of(self, spec: mujoco.MjSpec, name: str) -> list[mujoco.MjsGeom]:
        """The geoms of one object."""
        return list(spec.body(name).geoms)

    def cache_step(self, model: mujoco.MjModel) -> None:
        joints = [model.joint(f"{name}:{'free' if self.free else 'x'}") for name in self.names]
        n_q, n_v = (7, 6) if self.free else (4, 4)
        self.body_ids = np.array([model.body(name).id for name in self.names], int)
        self.geom_ids = np.array([model.geom(name).id for name in self.names], int)
        nested = np.isin(model.body_parentid, self.body_ids)
        if nested.any():
            inner = model.body(nested.argmax()).name
            raise ValueError(f"make: {inner!r} is a body inside an entity; takes a single body")
        # An entity of a user's own may have several geoms, the body's namesake among them.
        slots = [np.flatnonzero(model.geom_bodyid == body) for body in self.body_ids]
        self.all_geom_ids = np.concatenate([np.zeros(0, int), *slots])
        self.slot_of_geom = np.repeat(np.arange(self.n_max), [len(ids) for ids in slots])
        # x, y, z and yaw follow each other in qpos and qvel, as a free joint's parts do.
        self.qpos_ids = np.array([j.qposadr[0] + np.arange(n_q) for j in joints], int).reshape(-1, n_q)
        self.qvel_ids = np.array([j.dofadr[0] + np.arange(n_v) for j in joints], int).reshape(-1, n_v)

    def write(self, key: jax.Array, layout: Layout, params: DomainParams, places: Places) -> Layout:
        active = places.active
        height = places.extents[:, 2:] / 2 - self.rest_depth
        turn = places.yaw[:, None]
        if self.free:
            nothing = jnp.zeros_like(turn)
            turn = jnp.concatenate([jnp.cos(turn / 2), nothing, nothing, jnp.sin(turn / 2)], axis=1)
        position = jnp.concatenate([places.centre, height, turn], axis=1)
        ids = self.qpos_ids
        qpos = with_rows(layout.qpos, ids, jnp.where(active[:, None], position, layout.qpos[ids]))
        gravcomp = with_rows(layout.fields["body_gravcomp"], self.body_ids, jnp.where(active, 0.0, 1.0))
        fields = self.draw_fields(key, layout.fields | {"body_gravcomp": gravcomp}, params, places)
        return layout.replace(qpos=qpos, fields=fields)

    def draw(self, ranged: Ranged, key: jax.Array, params: DomainParams) -> jax.Array:
        """(n_max,) of a number that may be a range."""
        return ranged.draw(key, params, self.n_max, shared=not self.per_object)

    def draw_fields(self, key: jax.Array, fields: Fields, params: DomainParams, places: Places) -> Fields:
        """The model fields with what this world draws of masses, frictions and sizes."""
        if self.friction is None or not self.friction.varies:
            return fields
        sliding = self.draw(self.friction, key, params)
        frictions = fields["geom_friction"].at[self.all_geom_ids, 0].set(sliding[self.slot_of_geom])
        return fields | {"geom_friction": frictions}

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """`<kind>_obs` (n_max, 9): position, cos and sin of yaw, velocities; with free joints (n_max, 15): position,
        the first two columns of the rotation matrix, velocities. `<kind>_mask` (n_max,). Absent ones are zero.
        """
        if not self.n_max:
            return {}
        active = world.active[self.kind]
        obs = jnp.concatenate(self.observed(world, data), axis=1)
        return {f"{self.kind}_obs": jnp.where(active[:, None], obs, 0.0), f"{self.kind}_mask": active}

    def observed(self, world: World, data: Data) -> list[jax.Array]:
        """The columns of `<kind>_obs`, (n_max, k) each."""
        qpos, qvel = data.qpos[self.qpos_ids], data.qvel[self.qvel_ids]
        if self.free:
            turn = _first_columns(qpos[:, 3:])
        else:
            turn = jnp.stack([jnp.cos(qpos[:, 3]), jnp.sin(qpos[:, 3])], axis=1)
        return [qpos[:, :3], turn, qvel]


def _first_columns(quat: jax.Array) -> jax.Array:
    """(n, 6): the first two columns of the rotation matrices of unit quaternions (n, 4)."""
    w, x, y, z = quat.T
    first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    return jnp.stack(first + second, axis=1)
