"""The floor, root of every world."""

from __future__ import annotations

import mujoco
import numpy as np

from maax_mjx.common.colours import Colour, colour
from maax_mjx.worldgen.obj import Obj, Placement
from maax_mjx.worldgen.written import Written

PARKING_HEIGHT = 20.0
"""Metres above the floor of the lowest parked entity."""
RGBA = colour("#f4f3ee")


class Floor(Obj):
    """A square plane whose lower-left corner is the origin of all coordinates.

    Objects go to its placement "top", or to "parking": 20 m up, one above the other, where a world keeps the entities
    that are not in play.

    Args:
        size: edge length in metres.
        friction: sliding friction; None keeps MuJoCo's default of 1.
        rgba: colour.
    """

    kind = "floor"

    def __init__(
        self,
        size: float = 6.0,
        *,
        friction: float | None = None,
        rgba: Colour = RGBA,
    ):
        super().__init__("floor")
        if not 0 < size < np.inf:
            raise ValueError(f"size: got {size}; takes a positive length in metres")
        self.edge, self.friction, self.rgba = float(size), friction, rgba

    def _draw_size(self, rng: np.random.Generator, room: np.ndarray) -> None:
        self.size = np.array([self.edge, self.edge, 0.0])
        area = np.array([self.edge, self.edge, np.inf])
        self.placements = {
            "top": Placement(np.zeros(3), area),
            "parking": Placement(np.array([0.0, 0.0, PARKING_HEIGHT]), area, stacked=True),
        }

    def _write(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> Written:
        half = self.edge / 2
        geom = parent.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, pos=[half, half, 0], size=[half, half, 0.1], condim=3,
            rgba=self.rgba,
        )  # fmt: skip
        if self.friction is not None:
            geom.friction[0] = self.friction
        return Written(spec, parent, [geom])
