"""Movable things in drawn numbers: agents, boxes, ramps, cylinders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.common.arrays import with_rows
from maax_mjx.common.checks import check_bool
from maax_mjx.common.observed import POSITION, ROTATION, SPIN, SPINS, TURN, VELOCITY, Column, Observed
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World
from maax_mjx.modules.from_model import from_model
from maax_mjx.modules.made import Inner, check_made
from maax_mjx.modules.placed import Placed, Places
from maax_mjx.modules.ranged import Ranged
from maax_mjx.physics import Data, Fields, Overlay
from maax_mjx.worldgen import Floor, Obj


class Entities(Placed):
    """A kind of movable object. Slots beyond the drawn number are parked above the arena, weightless and masked.

    A subclass sets `kind` and implements `make`.

    Attributes:
        rest_depth: metres by which an entity starts in the floor, which is how deep a soft contact holds it under
            earth's gravity. Placed at exactly zero it would touch or fall by the last bit of a float, and engines would
            not agree on its first steps.
        inner: the joints of bodies inside one of these entities, such as a drawer's; known once the module is added.
        contacts_each: contact points per entity in a jam, on MJX, which reports some points twice. In 128 worlds of the
            benchmarks' environment M, jammed for 1,000 steps under full force at -50 m/s^2, there were 23 at most; this
            allows 31.

    Args:
        count: number per world, or (low, high).
        extent: largest extents (x, y, z) of one entity in metres, as it begins: with its drawers open, if they are.
        placement_fn: one function for all, or a list with one per slot.
        friction: sliding friction, or a range of it; None keeps MuJoCo's default of 1.
        free: whether `make` gives a free joint instead of slides x, y, z and a yaw hinge.
        random_yaw: whether each starts at a uniformly random yaw; otherwise all at 0.
        per_object: whether every entity draws its own values from ranges; otherwise all of a world share one draw.
        minimum: least number that `count` may have.
    """

    rest_depth = 1.08e-4
    contacts_each = 6.5
    friction_name: str = ""
    friction_argument = "friction"
    inner: tuple[Inner, ...] = ()

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
        if type(self).make is Entities.make:
            raise ValueError(
                f"make: {type(self).__name__} has none; takes a class with a method make(name) that returns an object "
                "of maax_mjx.worldgen, such as Geom"
            )
        self.extent = np.asarray(extent, np.float32)
        self.friction_name = self.friction_name or f"{self.kind}_friction"
        self.friction = (
            None if friction is None else Ranged(self.friction_name, friction, argument=self.friction_argument)
        )
        self.free = check_bool("free", free)
        self.per_object = check_bool("per_object", per_object)

    def make(self, name: str) -> Obj:
        """Returns a new object of this kind for the object tree.

        It is a body of this name, in the middle of the object's bounding box, with a geom of this name and the joints
        `<name>:x`, `:y`, `:z` and `:yaw`; with `free`, the joint `<name>:free`. It may hold other bodies, fixed to it
        or on hinges and slides.
        """
        raise NotImplementedError

    @property
    def ranges(self) -> list[Ranged]:
        """The numbers of these entities that can be ranges, except their count."""
        return [self.friction] if self.friction else []

    @property
    def parameters(self) -> list[Parameter]:
        return super().parameters + [p for ranged in self.ranges for p in ranged.parameters]

    @property
    def overlay(self) -> Overlay:
        return {"body_gravcomp": self.all_body_ids} | self.friction_rows

    @property
    def friction_rows(self) -> Overlay:
        """Overlay rows of their friction, if it is drawn."""
        varies = self.friction is not None and self.friction.varies
        return {"geom_friction": self.all_geom_ids} if varies else {}

    def check(self, grid_size: int, floor_size: float) -> None:
        super().check(grid_size, floor_size)
        if self.n_max:
            name, who = self.names[0], type(self).__name__
            self.inner = check_made(self.make(name), name, who, self.extent, free=self.free)

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
        """Returns the geoms of one entity."""
        return list(spec.body(name).find_all("geom"))

    @from_model
    def body_ids(self) -> np.ndarray:
        """Body ids (n_max,), without the bodies inside."""
        return np.array([self.model.body(name).id for name in self.names], int)

    @from_model
    def _bodies_of_slots(self) -> list[np.ndarray]:
        return [np.flatnonzero(self.model.body_rootid == body) for body in self.body_ids]

    @from_model
    def all_body_ids(self) -> np.ndarray:
        """Ids of all bodies (n_bodies,), those inside of entities too, in the order of the slots."""
        return np.concatenate([np.zeros(0, int), *self._bodies_of_slots])

    @from_model
    def slot_of_body(self) -> np.ndarray:
        """Slot of each of `all_body_ids`, (n_bodies,)."""
        return np.repeat(np.arange(self.n_max), [len(ids) for ids in self._bodies_of_slots])

    def reach_of(self, world: World) -> jax.Array:
        """Returns the extents (n_max, 3) of the oriented boxes that agents reach for, in metres."""
        return self.extents_of(world)

    @from_model
    def geom_ids(self) -> np.ndarray:
        """Geom id of each entity's namesake, (n_max,)."""
        return np.array([self.model.geom(name).id for name in self.names], int)

    @from_model
    def _geoms_of_slots(self) -> list[np.ndarray]:
        # A user's entity may have several geoms, including the body's namesake.
        return [np.flatnonzero(self.model.body_rootid[self.model.geom_bodyid] == body) for body in self.body_ids]

    @from_model
    def all_geom_ids(self) -> np.ndarray:
        """Ids of all geoms (n_geoms,), in the order of the slots."""
        return np.concatenate([np.zeros(0, int), *self._geoms_of_slots])

    @from_model
    def slot_of_geom(self) -> np.ndarray:
        """Slot of each of `all_geom_ids`, (n_geoms,)."""
        return np.repeat(np.arange(self.n_max), [len(ids) for ids in self._geoms_of_slots])

    @from_model
    def qpos_ids(self) -> np.ndarray:
        """Indices (n_max, 4) of x, y, z and yaw in `qpos`; (n_max, 7) of position and quaternion with free joints."""
        first = [joint.qposadr[0] for joint in self._first_joints()]
        return _consecutive(first, 7 if self.free else 4)

    @from_model
    def qvel_ids(self) -> np.ndarray:
        """Indices (n_max, 4) of the velocities of x, y, z and yaw in `qvel`; (n_max, 6) with free joints."""
        first = [joint.dofadr[0] for joint in self._first_joints()]
        return _consecutive(first, 6 if self.free else 4)

    @from_model
    def inner_qpos_ids(self) -> np.ndarray:
        """Indices (n_max, n_inner) of the joints inside in `qpos`."""
        return np.array([joint.qposadr[0] for joint in self._inner_joints()], int).reshape(self.n_max, -1)

    @from_model
    def inner_qvel_ids(self) -> np.ndarray:
        """Indices (n_max, n_inner) of their velocities in `qvel`."""
        return np.array([joint.dofadr[0] for joint in self._inner_joints()], int).reshape(self.n_max, -1)

    def _inner_joints(self) -> list[Any]:
        return [self.model.joint(f"{name}:{inner.name}") for name in self.names for inner in self.inner]

    def _first_joints(self) -> list[Any]:
        # x, y, z and yaw are consecutive in qpos and qvel, as the parts of a free joint are.
        return [self.model.joint(f"{name}:{'free' if self.free else 'x'}") for name in self.names]

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
        floats = jnp.where(active, 0.0, 1.0)[self.slot_of_body]
        gravcomp = with_rows(layout.fields["body_gravcomp"], self.all_body_ids, floats)
        fields = self.draw_fields(key, layout.fields | {"body_gravcomp": gravcomp}, params, places)
        return layout.replace(qpos=qpos, fields=fields)

    def draw(self, ranged: Ranged, key: jax.Array, params: DomainParams) -> jax.Array:
        """Draws (n_max,) values of a number or range."""
        return ranged.draw(key, params, self.n_max, shared=not self.per_object)

    def draw_fields(self, key: jax.Array, fields: Fields, params: DomainParams, places: Places) -> Fields:
        """Returns the model fields with this world's draws of masses, frictions and sizes."""
        if self.friction is None or not self.friction.varies:
            return fields
        sliding = self.draw(self.friction, key, params)
        frictions = fields["geom_friction"].at[self.all_geom_ids, 0].set(sliding[self.slot_of_geom])
        return fields | {"geom_friction": frictions}

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """Returns `<kind>_obs` (n_max, 9): position, cos and sin of yaw, velocities; with free joints (n_max, 15):
        position, the first two columns of the rotation matrix, velocities. Joints inside add two columns each, position
        and velocity. `<kind>_mask` (n_max,). Absent entities are zero.
        """
        if not self.n_max:
            return {}
        active = world.active[self.kind]
        obs = jnp.concatenate(self.observation_columns(world, data), axis=1)
        return {f"{self.kind}_obs": jnp.where(active[:, None], obs, 0.0), f"{self.kind}_mask": active}

    def declared(self) -> dict[str, Observed]:
        if not self.n_max:
            return {}
        return {
            f"{self.kind}_obs": Observed((self.kind,), self.declared_columns()),
            f"{self.kind}_mask": Observed((self.kind,)),
        }

    def declared_columns(self) -> tuple[Column, ...]:
        """Returns the declarations of `observation_columns`."""
        own = (*POSITION, *ROTATION, *VELOCITY, *SPINS) if self.free else (*POSITION, *TURN, *VELOCITY, *SPIN)
        return own + tuple(column for inner in self.inner for column in inner.columns)

    def observation_columns(self, world: World, data: Data) -> list[jax.Array]:
        """Returns the columns of `<kind>_obs`, (n_max, k) each."""
        qpos, qvel = data.qpos[self.qpos_ids], data.qvel[self.qvel_ids]
        if self.free:
            turn = _first_columns(qpos[:, 3:])
        else:
            turn = jnp.stack([jnp.cos(qpos[:, 3]), jnp.sin(qpos[:, 3])], axis=1)
        inside = jnp.stack([data.qpos[self.inner_qpos_ids], data.qvel[self.inner_qvel_ids]], axis=-1)
        return [qpos[:, :3], turn, qvel] + ([inside.reshape(self.n_max, -1)] if self.inner else [])


def _consecutive(first: Sequence[int], n: int) -> np.ndarray:
    """Returns (len(first), n) consecutive numbers from each of `first` on."""
    return np.array([start + np.arange(n) for start in first], int).reshape(-1, n)


def _first_columns(quat: jax.Array) -> jax.Array:
    """Returns the first two columns (n, 6) of the rotation matrices of unit quaternions (n, 4)."""
    w, x, y, z = quat.T
    first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    return jnp.stack(first + second, axis=1)
