"""The floor, root of every world."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from maax_mjx.common.colours import Colour, colour
from maax_mjx.worldgen.checks import check_number, check_vector
from maax_mjx.worldgen.obj import Obj, Placement
from maax_mjx.worldgen.written import Written

PARKING_HEIGHT = 20.0
"""Metres above the floor of the lowest parked entity."""
RGBA = colour("#f4f3ee")


class Floor(Obj):
    """A rectangular plane whose lower-left corner is the origin of all coordinates.

    Objects go to its placement "top", or to "parking": 20 m up, one above the other, where a world keeps the entities
    that are not in play.

    Args:
        size: edge length in metres, or (x, y) of a rectangle. The floor of a `maax.Base` is square.
        friction: sliding friction; None keeps MuJoCo's default of 1.
        rgba: colour.

    Attributes:
        edges: (2,) metres, its lengths along x and y.

    Raises:
        ValueError: a length that is not positive and finite.
    """

    kind = "floor"

    def __init__(
        self,
        size: float | Sequence[float] = 6.0,
        *,
        friction: float | None = None,
        rgba: Colour = RGBA,
    ):
        super().__init__("floor")
        takes = "a positive length in metres, or two, along x and y"
        if isinstance(size, int | float | np.number):
            self.edges = np.full(2, check_number("size", size, takes, above=True))
        else:
            self.edges = check_vector("size", size, 2, takes, low=np.nextafter(0, 1))
        self.friction, self.rgba = friction, rgba

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        self.size = np.append(self.edges, 0.0)
        area = np.append(self.edges, np.inf)
        self.placements = {
            "top": Placement(np.zeros(3), area),
            "parking": Placement(np.array([0.0, 0.0, PARKING_HEIGHT]), area, stacked=True),
        }

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        half = self.edges / 2
        geom = parent.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, pos=[*half, 0], size=[*half, 0.1], condim=3, rgba=self.rgba,
        )  # fmt: skip
        if self.friction is not None:
            geom.friction[0] = self.friction
        return Written(spec, parent, [geom])
