"""Boxes and ramps."""

from __future__ import annotations

from collections.abc import Sequence

from maax_mjx.checks import check_friction, check_positive
from maax_mjx.layout import PlacementFn, uniform_placement
from maax_mjx.modules.entities import Entities
from maax_mjx.worldgen import Geom, Obj, Wedge

RAMP_SIZE = 0.5
MASS = 1.0


class Boxes(Entities):
    """Cubes that agents can push.

    Args:
        n_boxes: how many per world, or (low, high); drawn uniformly.
        placement_fn: one function for all, or a list with one per slot.
        box_size: edge length in metres.
        box_friction: sliding friction; None keeps MuJoCo's default of 1.
        free: a free joint instead of slides x, y, z and a yaw hinge.
        random_yaw: whether each starts turned by a uniformly random angle.

    Raises:
        ValueError: a negative or reversed count, or a size that is not positive.
    """

    name = "boxes"
    kind = "box"
    count_name = "n_boxes"

    def __init__(
        self,
        n_boxes: int | tuple[int, int] = 1,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        box_size: float = 0.5,
        box_friction: float | None = None,
        free: bool = False,
        random_yaw: bool = False,
    ):
        super().__init__(
            n_boxes, [check_positive("box_size", box_size)] * 3, placement_fn, free=free, random_yaw=random_yaw
        )
        self.friction = check_friction("box_friction", box_friction)

    def make(self, name: str) -> Obj:
        size = [float(e) for e in self.extent]
        rgba = (0.85, 0.63, 0.4, 1.0)
        return Geom("box", size, name=name, mass=MASS, friction=self.friction, free=self.free, rgba=rgba)


class Ramps(Entities):
    """Wedges of 0.5 m that rise at 45 degrees towards their -y edge.

    Args:
        n_ramps: how many per world, or (low, high); drawn uniformly.
        placement_fn: one function for all, or a list with one per slot.
        ramp_friction: sliding friction; None keeps MuJoCo's default of 1.
        free: a free joint instead of slides x, y, z and a yaw hinge.
        random_yaw: whether each starts turned by a uniformly random angle.

    Raises:
        ValueError: a negative or reversed count.
    """

    name = "ramps"
    kind = "ramp"
    count_name = "n_ramps"

    def __init__(
        self,
        n_ramps: int | tuple[int, int] = 1,
        placement_fn: PlacementFn | Sequence[PlacementFn] = uniform_placement,
        ramp_friction: float | None = None,
        free: bool = False,
        random_yaw: bool = False,
    ):
        super().__init__(n_ramps, [RAMP_SIZE] * 3, placement_fn, free=free, random_yaw=random_yaw)
        self.friction = check_friction("ramp_friction", ramp_friction)

    def make(self, name: str) -> Obj:
        return Wedge(RAMP_SIZE, name, mass=MASS, friction=self.friction, free=self.free)
