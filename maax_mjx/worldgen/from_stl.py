"""Objects from STL files."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha1
from pathlib import Path

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_number
from maax_mjx.worldgen.solid import Solid
from maax_mjx.worldgen.written import Written

HEADER = 80
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


class ObjFromSTL(Solid):
    """A mesh from a binary STL file, with its bounding box in its placement.

    The mesh is written into the model itself, so that an MJCF string of the world needs no files. MuJoCo collides its
    convex hull; mass and inertia are the hull's too, which is defined for meshes with holes as well.

    Contacts have condim 6, as in OpenAI's worldgen: a mesh may touch the ground in one or two points, where sliding
    friction alone stops neither its spin nor its roll.

    Args:
        path: the file, in metres.
        name: body and geom name; None numbers it after the file ("teapot0").
        mass: in kg; None with no `density` is 1 kg.
        density: in kg/m^3, instead of the mass.
        friction: sliding friction; None keeps MuJoCo's default of 1.
        damping: damping of the joints (N s/m, Nm s/rad).
        free: whether it has a free joint instead of slides x, y, z and a yaw hinge.
        rgba: colour.

    Raises:
        ValueError: no such file, not a binary STL file, a mesh without volume, both `mass` and `density`, or a value
            outside its range.
    """

    def __init__(
        self,
        path: str | Path,
        name: str | None = None,
        *,
        mass: float | None = None,
        density: float | None = None,
        friction: float | None = None,
        damping: float = 0.1,
        free: bool = False,
        rgba: Sequence[float] = (0.5, 0.5, 0.5, 1.0),
    ):
        if mass is not None and density is not None:
            raise ValueError(f"density: got {density!r} together with mass={mass!r}; takes one of the two")
        if density is not None:
            check_number("density", density, "a positive number of kg/m^3", above=True)
        mass = 1.0 if mass is None and density is None else mass
        super().__init__(name, mass=mass, friction=friction, damping=damping, free=free, rgba=rgba)
        self.density = density
        corners = read_stl(path)
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.kind = Path(path).stem
        self.extents = high - low
        self._vertices, faces = np.unique(corners - (low + high) / 2, axis=0, return_inverse=True)
        self._faces = faces.reshape(-1, 3)
        # Named by content: two files may share a name, and two objects a file.
        self._mesh = f"{self.kind}_{sha1(corners.tobytes(), usedforsecurity=False).hexdigest()[:8]}"
        self._check_compiles(path)

    def _check_compiles(self, path: str | Path) -> None:
        spec = mujoco.MjSpec()
        self._add_mesh(spec)
        spec.worldbody.add_body().add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=self._mesh)
        try:
            spec.compile()
        except ValueError as error:
            reason = str(error).splitlines()[0]
            raise ValueError(
                f"path: got {str(path)!r}, whose mesh MuJoCo refuses; takes a solid one ({reason})"
            ) from error

    def _add_mesh(self, spec: mujoco.MjSpec) -> None:
        if spec.mesh(self._mesh) is None:
            spec.add_mesh(
                name=self._mesh, uservert=self._vertices.ravel(), userface=self._faces.ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
            )  # fmt: skip

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        self.size = self.extents
        self.placements = {}

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        self._add_mesh(spec)
        density = {} if self.density is None else {"density": self.density}
        return self._write_geom(spec, parent, condim=6, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=self._mesh, **density)


def read_stl(path: str | Path) -> np.ndarray:
    """Returns the corners of all triangles of a binary STL file, (3 * n_triangles, 3), in the file's units.

    Raises:
        ValueError: no such file, or not a binary STL file.
    """
    file = Path(path)
    if not file.is_file():
        raise ValueError(f"path: got {str(path)!r}, which is no file; takes a binary STL file")
    content = file.read_bytes()
    count = int.from_bytes(content[HEADER : HEADER + 4], "little")
    wanted = HEADER + 4 + count * FACET.itemsize
    if len(content) < HEADER + 4 or len(content) != wanted:
        text = ", a text file: save it as binary" if content[:5] == b"solid" else ""
        raise ValueError(f"path: got {str(path)!r}, of {len(content)} bytes{text}; takes a binary STL file")
    if not count:
        raise ValueError(f"path: got {str(path)!r}, of 0 triangles; takes a solid mesh")
    return np.frombuffer(content, FACET, count, HEADER + 4)["corners"].reshape(-1, 3).astype(float)
