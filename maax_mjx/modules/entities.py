"""Movable things that a world holds a drawn number of: agents, boxes, ramps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.checks import check_count_range, check_per_object
from maax_mjx.layout import Layout, PlacementFn
from maax_mjx.modules.module import Module
from maax_mjx.params import DomainParams, Parameter
from maax_mjx.physics import Data, Overlay, World
from maax_mjx.worldgen import Floor, Obj


class Entities(Module):
    """A kind of movable object. Slots beyond the drawn count stay parked above the arena, weightless and masked.

    A subclass sets `name`, `kind` and `count_name`, and implements `make`.

    Attributes:
        rest_depth: how deep in the floor one starts, in metres, which is how deep a soft contact holds it under earth's
            gravity. Put down at exactly zero it would be in contact or fall by the last bit of a float, and no two
            engines would agree on its first steps.
        is_round: whether turning one leaves its footprint as it is.
        contacts_each: contact points of one in a jam, on MJX, which gives some points twice. In 128 worlds of M, jammed
            for 1,000 steps under full force at -50 m/s^2, the most were 23, of 31 that this makes.

    Args:
        count: how many per world, or (low, high).
        extent: (x, y, z) of one in metres.
        placement_fn: where they go: one function for all, or a list with one for each slot.
        free: whether `make` gives a free joint rather than slides x, y, z and a yaw hinge.
        random_yaw: whether each starts turned by a uniformly random angle; else all at yaw 0.
    """

    kind: str
    count_name: str
    rest_depth = 1.08e-4
    contacts_each = 6.5
    is_round = False

    def __init__(
        self,
        count: int | tuple[int, int],
        extent: Sequence[float],
        placement_fn: PlacementFn | Sequence[PlacementFn],
        *,
        free: bool = False,
        random_yaw: bool = False,
        minimum: int = 0,
    ):
        self.count = check_count_range(self.count_name, count, minimum)
        self.n_max = self.count[1]
        self.extent = np.asarray(extent, np.float32)
        self.placement_fns: list[Callable] = check_per_object("placement_fn", placement_fn, self.n_max)
        self.free = free
        self.random_yaw = random_yaw
        self.requires_quadrant = any(getattr(fn, "requires_quadrant", False) for fn in self.placement_fns)

    def make(self, name: str) -> Obj:
        """A new object of this kind for the tree."""
        raise NotImplementedError

    @property
    def parameters(self) -> list[Parameter]:
        return [Parameter(self.count_name, self.count, (0, self.n_max))]

    @property
    def overlay(self) -> Overlay:
        return {"body_gravcomp": self.body_ids}

    @property
    def contact_points(self) -> float:
        return self.contacts_each * self.n_max

    @property
    def extents(self) -> list[tuple[float, float]]:
        x, y = map(float, self.extent[:2])
        if self.random_yaw and not self.is_round:
            x = y = hypot(x, y)
        return [(x, y)] * self.n_max

    def build_step(self, floor: Floor, grid_size: int) -> None:
        for i in range(self.n_max):
            floor.append(self.make(f"{self.kind}{i}"), "parking", (0.5, 0.5))

    def cache_step(self, model: mujoco.MjModel) -> None:
        names = [f"{self.kind}{i}" for i in range(self.n_max)]
        first = ["free" if self.free else "x"]
        joints = [model.joint(f"{name}:{first[0]}") for name in names]
        n_q, n_v = (7, 6) if self.free else (4, 4)
        self.body_ids = np.array([model.body(name).id for name in names], int)
        self.geom_ids = np.array([model.geom(name).id for name in names], int)
        # x, y, z and yaw follow each other in qpos and qvel, as a free joint's parts do.
        self.qpos_ids = np.array([j.qposadr[0] + np.arange(n_q) for j in joints], int).reshape(-1, n_q)
        self.qvel_ids = np.array([j.dofadr[0] + np.arange(n_v) for j in joints], int).reshape(-1, n_v)

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        if not self.n_max:
            return layout.replace(active=layout.active | {self.kind: jnp.zeros(0, bool)})
        wanted = jnp.arange(self.n_max) < params.draw_count(jax.random.fold_in(key, self.n_max), self.count_name)
        seeds = layout.seeds(key, self.n_max)
        yaw = self._draw_yaw(key, layout)
        extents = self._turned_extents(yaw)
        centres, placed = [], []
        for i, fn in enumerate(self.placement_fns):
            layout, centre, ok = layout.place(f"{self.kind}{i}", seeds[i], extents[i], fn, wanted[i])
            centres.append(centre)
            placed.append(ok)
        active = jnp.stack(placed)
        height = jnp.full((self.n_max, 1), self.extent[2] / 2 - self.rest_depth)
        turn = yaw[:, None]
        if self.free:
            nothing = jnp.zeros_like(turn)
            turn = jnp.concatenate([jnp.cos(turn / 2), nothing, nothing, jnp.sin(turn / 2)], axis=1)
        position = jnp.concatenate([jnp.stack(centres), height, turn], axis=1)
        ids = self.qpos_ids
        qpos = layout.qpos.at[ids].set(jnp.where(active[:, None], position, layout.qpos[ids]))
        gravcomp = layout.fields["body_gravcomp"].at[self.body_ids].set(jnp.where(active, 0.0, 1.0))
        return layout.replace(
            qpos=qpos,
            fields=layout.fields | {"body_gravcomp": gravcomp},
            active=layout.active | {self.kind: active},
        )

    def _draw_yaw(self, key: jax.Array, layout: Layout) -> jax.Array:
        """(n_max,) radians in [0, 2 pi); zeros unless `random_yaw`."""
        if not self.random_yaw:
            return jnp.zeros(self.n_max)
        bits = layout.seeds(jax.random.fold_in(key, self.n_max + 1), self.n_max)[:, 0]
        return (bits >> 8).astype(jnp.float32) / 2**24 * 2 * jnp.pi

    def _turned_extents(self, yaw: jax.Array) -> jax.Array:
        """(n_max, 2) extents along x and y of the turned objects' bounding boxes, in metres."""
        x, y = self.extent[0], self.extent[1]
        if self.is_round:
            return jnp.broadcast_to(jnp.stack([x, y]), (self.n_max, 2))
        cos, sin = jnp.abs(jnp.cos(yaw)), jnp.abs(jnp.sin(yaw))
        return jnp.stack([cos * x + sin * y, sin * x + cos * y], axis=1)

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """`<kind>_obs` (n_max, 9): position, cos and sin of yaw, velocities; with free joints (n_max, 15): position,
        the first two columns of the rotation matrix, velocities. `<kind>_mask` (n_max,). Absent ones are zero.
        """
        if not self.n_max:
            return {}
        active = world.active[self.kind]
        qpos, qvel = data.qpos[self.qpos_ids], data.qvel[self.qvel_ids]
        if self.free:
            matrix = data.geom_xmat[self.geom_ids]
            turn = jnp.concatenate([matrix[:, :, 0], matrix[:, :, 1]], axis=1)
        else:
            turn = jnp.stack([jnp.cos(qpos[:, 3]), jnp.sin(qpos[:, 3])], axis=1)
        obs = jnp.concatenate([qpos[:, :3], turn, qvel], axis=1)
        return {f"{self.kind}_obs": jnp.where(active[:, None], obs, 0.0), f"{self.kind}_mask": active}
