"""The base class of objects with a single geom."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco

from maax_mjx.worldgen.checks import check_number, check_rgba
from maax_mjx.worldgen.joints import Joint, add_body
from maax_mjx.worldgen.obj import Obj
from maax_mjx.worldgen.written import Written, body_position


class Solid(Obj):
    """An object of one geom. A subclass implements `_draw_size`, and `_write` with `_write_geom`.

    Args:
        name: body and geom name.
        mass: in kg; None leaves it to the geom's density.
        friction: sliding friction; None keeps MuJoCo's default of 1.
        damping: damping of the joints (N s/m, Nm s/rad).
        free: whether it has a free joint instead of slides x, y, z and a yaw hinge.
        joint: a hinge or slide as its only joint instead.
        rgba: colour.

    Raises:
        ValueError: a mass that is not positive, negative friction or damping, an invalid colour, or a `joint`
            with `free`.
    """

    def __init__(
        self,
        name: str | None,
        *,
        mass: float | None,
        friction: float | None,
        damping: float,
        free: bool,
        rgba: Sequence[float],
        joint: Joint | None = None,
    ):
        super().__init__(name)
        if mass is not None:
            check_number("mass", mass, "a positive number of kg", above=True)
        if friction is not None:
            check_number("friction", friction, "a number of at least 0, or None")
        check_number("damping", damping, "a number of at least 0, in N s/m or Nm s/rad")
        check_rgba("rgba", rgba)
        if joint is not None and (free or not isinstance(joint, Joint)):
            raise ValueError(f"joint: got {joint!r} with free={free}; takes a Hinge or Slide with free=False, or None")
        self.joint = joint
        self.mass, self.friction, self.damping, self.free, self.rgba = mass, friction, damping, free, rgba

    def _write_geom(self, spec: mujoco.MjSpec, parent: mujoco.MjsBody, condim: int = 3, **fields: Any) -> Written:
        """Adds the geom to the parent's body if the object is static, else to a new body."""
        assert self.name is not None
        if self.static:
            body, fields = parent, fields | {"pos": self.centre - body_position(parent)}
        else:
            body = add_body(spec, self.name, self.centre, joint=self.joint, free=self.free, damping=self.damping)
            if self.mass is not None:
                fields["mass"] = self.mass
        geom = body.add_geom(name=self.name, condim=condim, rgba=self.rgba, **fields)
        if self.friction is not None:
            geom.friction[0] = self.friction
        return Written(spec, body, [geom], [] if self.static else list(body.joints))
