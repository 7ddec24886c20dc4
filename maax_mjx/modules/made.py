"""The check of what `Entities.make` returns."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from maax_mjx.common.checks import described
from maax_mjx.common.observed import Column
from maax_mjx.worldgen import Floor, Obj, WorldBuilder

SLIDE, HINGE = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
UPRIGHT = (("x", SLIDE, (1, 0, 0)), ("y", SLIDE, (0, 1, 0)), ("z", SLIDE, (0, 0, 1)), ("yaw", HINGE, (0, 0, 1)))
"""Joints in their order: name, type, axis."""
PARKING = 1e3
"""Metres: the edge of a floor that has room for anything."""
TOO_LARGE = 1e-3
"""Metres by which an object may exceed its extent."""


class Inner(NamedTuple):
    """A joint of a body inside an entity.

    Attributes:
        name: without the entity's name: "drawer" for "table0:drawer".
        turns: whether it is a hinge; otherwise a slide.
    """

    name: str
    turns: bool

    @property
    def columns(self) -> tuple[Column, Column]:
        """The columns that it adds to what is observed of its entity: position and velocity."""
        unit, scale, speed = ("rad", np.pi, 6.0) if self.turns else ("m", 1.0, 3.0)
        return Column(self.name, unit, scale), Column(f"{self.name} velocity", f"{unit}/s", speed)


def check_made(made: Any, name: str, who: str, extent: np.ndarray, *, free: bool) -> tuple[Inner, ...]:
    """Returns the joints of bodies inside an object, which is refused if `Entities` cannot place, move and observe it.

    Args:
        made: what `make(name)` returned.
        name: the object's name.
        who: class that made it.
        extent: (3,), what the class says that it takes of the floor at most, in metres.
        free: whether it should have a free joint.

    Raises:
        ValueError: no object, one of another name, no geom of the object's name, other joints, a body that is not in
            the middle of the object, an object larger than its extent, ball joints inside, or equalities and tendons.
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
    if f"{name}:yaw" in made.default_qpos:
        raise ValueError(
            f"default_qpos: got a value for '{name}:yaw'; takes joints inside: its place gives an entity's yaw"
        )
    # Layouts put the body where the middle of the object goes.
    off = body.pos - made.centre
    if not np.allclose(off, 0, atol=1e-4):
        raise ValueError(
            f"make: {who} returned a body {np.round(off, 4).tolist()} m from the middle of its object; takes one in "
            "the middle, as in a file where the box of 'annotation:outer_bound' is around the origin of 'main'"
        )
    # Layouts keep the extent free, so that what is larger would begin inside of other things.
    if (made.size > np.asarray(extent) + TOO_LARGE).any():
        raise ValueError(
            f"make: {who} returned an object of {_metres(made.size)} m; takes one no larger than the extent that "
            f"{who} has, {_metres(extent)} m"
        )
    for kind, elements in (("an equality", spec.equalities), ("a tendon", spec.tendons)):
        if elements:
            raise ValueError(f"make: {who} returned an object with {kind}; takes bodies, geoms, joints and sites")
    inside = [joint for joint in body.find_all("joint") if joint.parent.name != name]
    for joint in inside:
        if joint.type not in (SLIDE, HINGE):
            raise ValueError(
                f"make: {who} returned an object with {joint.name!r}, a ball joint; takes hinges and slides inside"
            )
    return tuple(Inner(joint.name.removeprefix(f"{name}:"), joint.type == HINGE) for joint in inside)


def _metres(size: np.ndarray) -> str:
    return " x ".join(f"{edge:.3g}" for edge in size)


def _is_free(joints: list[tuple[str, int, np.ndarray]]) -> bool:
    return [(label, kind) for label, kind, _ in joints] == [("free", mujoco.mjtJoint.mjJNT_FREE)]


def _is_upright(joints: list[tuple[str, int, np.ndarray]]) -> bool:
    return len(joints) == len(UPRIGHT) and all(
        (label, kind) == (wanted, type_) and np.allclose(axis / np.linalg.norm(axis), direction)
        for (label, kind, axis), (wanted, type_, direction) in zip(joints, UPRIGHT, strict=True)
    )
