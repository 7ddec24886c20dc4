"""The check of what `Entities.make` returns."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from maax_mjx.common.checks import described
from maax_mjx.worldgen import Floor, Obj, WorldBuilder

SLIDE, HINGE = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
UPRIGHT = (("x", SLIDE, (1, 0, 0)), ("y", SLIDE, (0, 1, 0)), ("z", SLIDE, (0, 0, 1)), ("yaw", HINGE, (0, 0, 1)))
"""Joints in their order: name, type, axis."""
PARKING = 1e3
"""Metres: the edge of a floor that has room for anything."""


def check_made(made: Any, name: str, who: str, *, free: bool) -> None:
    """Refuses an object that is not what `Entities` places, moves and observes.

    Args:
        made: what `make(name)` returned.
        name: the object's name.
        who: class that made it.
        free: whether it should have a free joint.

    Raises:
        ValueError: no object, one of another name, several bodies, no geom of the object's name, or other joints.
    """
    if not isinstance(made, Obj):
        raise ValueError(
            f"make: {who} returned {described(made)}; takes an object of maax_mjx.worldgen, such as Geom or ObjFromXML"
        )
    floor, builder = Floor(PARKING), WorldBuilder()
    builder.append(floor).append(made, "parking", (0.5, 0.5))
    spec = builder.to_spec()
    body = spec.body(name)
    if made.name != name or body is None:
        raise ValueError(f"make: {who} returned an object named {made.name!r}; takes one with a body named {name!r}")
    if inner := [b.name for b in body.bodies]:
        raise ValueError(f"make: {inner[0]!r} is a body inside an entity; takes a single body")
    if name not in [geom.name for geom in body.geoms]:
        raise ValueError(
            f"make: {who} returned a body without a geom named {name!r}; takes one, which a file names 'main'"
        )
    joints = [(joint.name.removeprefix(f"{name}:"), joint.type, joint.axis) for joint in body.joints]
    if not (_is_free(joints) if free else _is_upright(joints)):
        takes = "'free', a free joint" if free else "'x', 'y', 'z', slides along the axes, and 'yaw', a hinge about z"
        raise ValueError(
            f"make: {who}(free={free}) returned a body with the joints {[label for label, _, _ in joints]}; takes "
            f"{takes}, in this order. What moves otherwise, as a door does on its hinge, is a subclass of Module"
        )


def _is_free(joints: list[tuple[str, int, np.ndarray]]) -> bool:
    return [(label, kind) for label, kind, _ in joints] == [("free", mujoco.mjtJoint.mjJNT_FREE)]


def _is_upright(joints: list[tuple[str, int, np.ndarray]]) -> bool:
    return len(joints) == len(UPRIGHT) and all(
        (label, kind) == (wanted, type_) and np.allclose(axis / np.linalg.norm(axis), direction)
        for (label, kind, axis), (wanted, type_, direction) in zip(joints, UPRIGHT, strict=True)
    )
