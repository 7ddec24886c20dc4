"""Primitive objects: boxes, spheres, cylinders, and the wedge that ramps are made of."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_number
from maax_mjx.worldgen.joints import Joint
from maax_mjx.worldgen.obj import Placement
from maax_mjx.worldgen.solid import Solid
from maax_mjx.worldgen.written import Written

TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
}


class Geom(Solid):
    """A primitive body.

    Args:
        geom_type: "box", "sphere" or "cylinder".
        min_size: full extents in metres: (x, y, z) of a box, (diameter,) of a sphere, (diameter, height) of a
            cylinder.
        max_size: upper extents; each extent is drawn uniformly between the two, and along x and y cut to what the
            placement holds, but not below `min_size` (as in OpenAI's worldgen).
        name: body and geom name.
        mass: in kg.
        friction: sliding friction; None keeps MuJoCo's default of 1.
        damping: damping of the joints (N s/m, Nm s/rad).
        free: whether it has a free joint instead of slides x, y, z and a yaw hinge.
        joint: a `Hinge` or `Slide` as its only joint instead: a door, a drawer.
        rgba: colour.

    Raises:
        ValueError: an unknown type, a wrong number of extents, an extent that is not positive, or a `joint` with
            `free`.
    """

    def __init__(
        self,
        geom_type: str,
        min_size: Sequence[float],
        max_size: Sequence[float] | None = None,
        name: str | None = None,
        *,
        mass: float = 1.0,
        friction: float | None = None,
        damping: float = 0.01,
        free: bool = False,
        joint: Joint | None = None,
        rgba: Sequence[float] = (0.5, 0.5, 0.5, 1.0),
    ):
        super().__init__(name, mass=mass, friction=friction, damping=damping, free=free, rgba=rgba, joint=joint)
        if geom_type not in TYPES:
            raise ValueError(f"geom_type: got {geom_type!r}; takes one of {sorted(TYPES)}")
        n_extents = {"box": 3, "sphere": 1, "cylinder": 2}[geom_type]
        low, high = np.asarray(min_size, float), np.asarray(min_size if max_size is None else max_size, float)
        if low.shape != (n_extents,) or high.shape != (n_extents,) or not (low > 0).all() or not (low <= high).all():
            raise ValueError(
                f"min_size, max_size: got {min_size}, {max_size}; a {geom_type} takes {n_extents} positive extents "
                "in metres, min_size <= max_size"
            )
        self.kind = geom_type
        self.low, self.high = low, high

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        extents = rng.uniform(self.low, self.high)
        widths, limit = (slice(2), room) if self.kind == "box" else (slice(1), room.min())
        extents[widths] = np.maximum(np.minimum(extents[widths], limit), self.low[widths])
        self.size = {
            "box": lambda e: e,
            "sphere": lambda e: np.repeat(e, 3),
            "cylinder": lambda e: np.array([e[0], e[0], e[1]]),
        }[self.kind](extents)
        top = Placement(np.array([0.0, 0.0, self.size[2]]), np.array([*self.size[:2], np.inf]))
        self.placements = {"top": top}

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        half = self.size / 2
        size = {"box": half, "sphere": [half[0], 0, 0], "cylinder": [half[0], half[2], 0]}[self.kind]
        return self._write_geom(spec, parent, type=TYPES[self.kind], size=size)


class Wedge(Solid):
    """A ramp: a triangular prism that rises at 45 degrees towards its -y edge.

    Args:
        extent: edge length in metres, the same along x, y and z.
        name, mass, friction, damping, free, rgba: as for `Geom`.
    """

    kind = "wedge"

    def __init__(
        self,
        extent: float = 0.5,
        name: str | None = None,
        *,
        mass: float = 1.0,
        friction: float | None = None,
        damping: float = 0.1,
        free: bool = False,
        rgba: Sequence[float] = (0.9, 0.8, 0.3, 1.0),
    ):
        super().__init__(name, mass=mass, friction=friction, damping=damping, free=free, rgba=rgba)
        self.extent = check_number("extent", extent, "a positive length in metres", above=True)

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        self.size = np.full(3, self.extent)
        self.placements = {}

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        mesh = f"wedge_{self.extent:g}"
        if spec.mesh(mesh) is None:
            spec.add_mesh(name=mesh, uservert=(wedge_vertices() * self.extent).ravel())
        return self._write_geom(spec, parent, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh)


def wedge_vertices() -> np.ndarray:
    """Returns the six corners (6, 3) of a unit wedge centred on its bounding box."""
    corners = [(x, y, z) for x in (-0.5, 0.5) for y, z in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5))]
    return np.array(corners)
