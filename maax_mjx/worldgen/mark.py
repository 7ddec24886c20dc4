"""Marks: named sites on objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_choice, check_number, check_rgba, check_vector
from maax_mjx.worldgen.written import Written, body_position

CENTRE = (0.5, 0.5, 0.5)
TYPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}


@dataclass(frozen=True)
class Mark:
    """A site on an object; the arguments are those of `Obj.mark`."""

    name: str
    relative_xyz: Sequence[float]
    absolute_xyz: Sequence[float] | None
    rgba: Sequence[float]
    geom_type: str
    size: float

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"name: got {self.name!r}; takes the name of a site")
        check_vector("relative_xyz", self.relative_xyz, 3, "three fractions of the object's extents")
        if self.absolute_xyz is not None:
            check_vector("absolute_xyz", self.absolute_xyz, 3, "three lengths in metres, or None")
            if tuple(self.relative_xyz) != CENTRE:
                raise ValueError(
                    f"absolute_xyz: got {self.absolute_xyz!r} with relative_xyz={self.relative_xyz!r}; takes one of "
                    "the two"
                )
        check_rgba("rgba", self.rgba)
        check_choice("geom_type", self.geom_type, list(TYPES))
        check_number("size", self.size, "a positive number of metres", above=True)

    def write(self, written: Written, position: np.ndarray, size: np.ndarray) -> None:
        """Adds the site to an object's part of the spec; `position` (3,) is its lower corner in metres, `size` its
        extents.

        Raises:
            ValueError: the world already has a site of that name.
        """
        if written.spec.site(self.name) is not None:
            raise ValueError(f"name: the world has a mark {self.name!r} already; takes a name of its own for each")
        offset = size * self.relative_xyz if self.absolute_xyz is None else np.asarray(self.absolute_xyz, float)
        site = written.body.add_site(
            name=self.name,
            type=TYPES[self.geom_type],
            pos=position + offset - body_position(written.body),
            size=[self.size] * 3,
            rgba=self.rgba,
        )
        written.sites.append(site)
