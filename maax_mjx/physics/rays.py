"""Rays against the geoms of a world: what `mujoco.mj_ray` finds, for all rays and geoms in one fused computation.

Every geom is convex, so that a ray is inside it over one interval (enter, leave) of distances; planes are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.physics.data import Data
from maax_mjx.physics.fields import Fields, Overlay

BOX, SPHERE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)
CYLINDER, MESH = int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_MESH)
PARALLEL = 1e-9
NO_BODY = -1
"""In place of the id of a body, where there is none."""

Interval = tuple[jax.Array, jax.Array]


class Rays:
    """Casts rays in worlds of one model.

    Args:
        model: the compiled model; its meshes are taken as their convex hulls.
        overlay: the rows in which worlds differ.
    """

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        self._size = model.geom_size
        self._size_rows = overlay.get("geom_size", np.zeros(0, int))
        of_type = {kind: np.flatnonzero(model.geom_type == kind) for kind in (BOX, SPHERE, CYLINDER, MESH)}
        self._ids = {kind: ids for kind, ids in of_type.items() if len(ids)}
        order = np.concatenate([np.zeros(0, int), *self._ids.values()])
        self._body = model.body_rootid[model.geom_bodyid[order]]
        self._geom = order
        meshes = [int(model.geom_dataid[geom]) for geom in self._ids.get(MESH, ())]
        self._planes = _stacked([_hull_planes(model, mesh) for mesh in meshes])

    def cast(
        self, fields: Fields, data: Data, origin: jax.Array, direction: jax.Array, without: np.ndarray
    ) -> tuple[jax.Array, jax.Array]:
        """Finds the nearest hit of every ray.

        Args:
            fields: the world's overlaid fields.
            data: its state, with the poses that belong to it.
            origin: (n, 3) metres.
            direction: (n, m, 3) of unit length: m rays from every origin.
            without: (n,) ids of the bodies that rays do not see, nor what is inside these: those that they come from.

        Returns:
            (n, m) distances in metres, infinite where nothing is hit; (n, m) int32 ids of the geoms that were hit, -1
            for none. A ray that starts inside a geom hits it where it leaves it, as in `mj_ray`.
        """
        size = jnp.asarray(self._size, origin.dtype)
        if self._size_rows.size:
            size = size.at[self._size_rows].set(fields["geom_size"])
        intervals = [self._through(kind, ids, size, data, origin, direction) for kind, ids in self._ids.items()]
        if not intervals:
            shape = direction.shape[:2]
            return jnp.full(shape, jnp.inf), jnp.full(shape, -1, jnp.int32)
        enter, leave = (jnp.concatenate(parts, axis=2) for parts in zip(*intervals, strict=True))
        own = np.asarray(without)[:, None, None] == self._body
        hit = jnp.where(enter >= 0, enter, leave)
        distance = jnp.where((enter <= leave) & (leave >= 0) & ~own, hit, jnp.inf)
        found = distance.min(axis=2)
        # Of equal ones the first; cheaper than an argmin.
        nearest = jnp.where(distance == found[..., None], np.arange(len(self._geom)), len(self._geom)).min(axis=2)
        return found, jnp.where(jnp.isfinite(found), jnp.asarray(self._geom)[nearest], -1).astype(jnp.int32)

    def _through(
        self, kind: int, ids: np.ndarray, size: jax.Array, data: Data, origin: jax.Array, direction: jax.Array
    ) -> Interval:
        """Distances (n, m, n_geoms) where rays enter and leave the geoms of one kind.

        Vectors are taken apart into their components, so that the geoms' axis is the last, which vectorises.
        """
        pos, mat, size = data.geom_xpos[ids], data.geom_xmat[ids], size[ids]
        offset = [origin[:, i, None] - pos[:, i] for i in range(3)]
        ahead = [direction[..., i, None] for i in range(3)]
        if kind == SPHERE:
            return _sphere([x[:, None] for x in offset], ahead, size[:, 0])
        # Into the geoms' frames, the origins once for all of their rays.
        start = [_dot(offset, mat[:, :, i].T)[:, None] for i in range(3)]
        along = [_dot(ahead, mat[:, :, i].T) for i in range(3)]
        if kind == BOX:
            return _slabs(start, along, list(size.T))
        if kind == CYLINDER:
            return _cylinder(start, along, size)
        return _convex(start, along, self._planes)


Vector = Sequence[jax.Array]
"""Components of a vector along x, y and z."""


def _dot(a: Vector, b: Vector | jax.Array) -> jax.Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sphere(offset: Vector, direction: Vector, radius: jax.Array) -> Interval:
    along = _dot(offset, direction)
    inside = along**2 - _dot(offset, offset) + radius**2
    half = jnp.sqrt(jnp.maximum(inside, 0.0))
    return jnp.where(inside >= 0, -along - half, jnp.inf), jnp.where(inside >= 0, -along + half, -jnp.inf)


def _slabs(start: Vector, along: Vector, half: Vector) -> Interval:
    enter, leave = [], []
    for at, speed, reach in zip(start, along, half, strict=True):
        per_metre = 1 / jnp.where(jnp.abs(speed) < PARALLEL, PARALLEL, speed)
        middle, spread = -at * per_metre, reach * jnp.abs(per_metre)
        enter.append(middle - spread)
        leave.append(middle + spread)
    return reduce(jnp.maximum, enter), reduce(jnp.minimum, leave)


def _cylinder(start: Vector, along: Vector, size: jax.Array) -> Interval:
    a = jnp.maximum(along[0] ** 2 + along[1] ** 2, PARALLEL)
    b = start[0] * along[0] + start[1] * along[1]
    inside = b**2 - a * (start[0] ** 2 + start[1] ** 2 - size[:, 0] ** 2)
    half = jnp.sqrt(jnp.maximum(inside, 0.0))
    enter, leave = _slabs(start[2:], along[2:], [size[:, 1]])
    enter, leave = jnp.maximum(enter, (-b - half) / a), jnp.minimum(leave, (-b + half) / a)
    return jnp.where(inside >= 0, enter, jnp.inf), jnp.where(inside >= 0, leave, -jnp.inf)


def _convex(start: Vector, along: Vector, planes: np.ndarray) -> Interval:
    """Intersects rays with hulls; `planes` (n_geoms, n_planes, 4): outward normals, and how far out the planes are."""
    enter, leave = [], []
    for i in range(planes.shape[1]):
        normal, out = jnp.asarray(planes[:, i, :3].T), planes[:, i, 3]
        speed, gap = _dot(along, normal), out - _dot(start, normal)
        parallel = jnp.abs(speed) < PARALLEL
        reach = gap / jnp.where(parallel, 1.0, speed)
        enter.append(jnp.where(parallel, jnp.where(gap < 0, jnp.inf, -jnp.inf), jnp.where(speed < 0, reach, -jnp.inf)))
        leave.append(jnp.where(parallel | (speed < 0), jnp.inf, reach))
    return reduce(jnp.maximum, enter), reduce(jnp.minimum, leave)


def _hull_planes(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Planes (n_planes, 4) of a mesh's convex hull in its own frame, from the hull that MuJoCo's compiler made."""
    start = int(model.mesh_graphadr[mesh])
    n_verts, n_faces = model.mesh_graph[start : start + 2]
    # The hull's graph: its numbers, an edge address and an id of every vertex, the edges, and three ids a face.
    first = start + 2 + 3 * n_verts + 3 * n_faces
    faces = model.mesh_graph[first : first + 3 * n_faces].reshape(-1, 3)
    corners = model.mesh_vert[model.mesh_vertadr[mesh] + faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.sign(((corners[:, 0] - corners.mean(axis=(0, 1))) * normal).sum(axis=1, keepdims=True))
    out = (corners[:, 0] * normal).sum(axis=1, keepdims=True)
    return np.unique(np.round(np.concatenate([normal, out], axis=1), 7), axis=0).astype(np.float32)


def _stacked(hulls: list[np.ndarray]) -> np.ndarray:
    """Stacks hulls as (n_geoms, n_planes, 4), filled up with each hull's first plane."""
    most = max((len(planes) for planes in hulls), default=0)
    filled = [np.concatenate([planes, np.repeat(planes[:1], most - len(planes), axis=0)]) for planes in hulls]
    return np.stack(filled) if filled else np.zeros((0, 0, 4), np.float32)
