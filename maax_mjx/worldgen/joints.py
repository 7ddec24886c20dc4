"""Joints of movable objects.

The slides of objects that move freely are in absolute coordinates: `ref` makes qpos the position of the body itself. A
slide's qpos is the body's coordinate in metres in the floor frame, like a free joint's, and the model's default
configuration is where the object was placed. A single `Hinge` or `Slide` is at 0 there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_vector

SLIDES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


@dataclass(frozen=True)
class Hinge:
    """A joint about which an object turns, as a door does. Its name is `<name>:hinge`.

    Attributes:
        axis: (3,) direction of the axis, in the floor's frame.
        anchor: (3,) metres from the object's centre to a point of the axis.
        range: (low, high) radians between which it turns, from where it was placed; None turns without end.
    """

    axis: Sequence[float] = (0.0, 0.0, 1.0)
    anchor: Sequence[float] = (0.0, 0.0, 0.0)
    range: Sequence[float] | None = None

    def __post_init__(self) -> None:
        _check_joint(self.axis, self.range, "radians")
        check_vector("anchor", self.anchor, 3, "three numbers, metres from the centre")

    def write(self, body: mujoco.MjsBody, name: str, damping: float) -> None:
        """Adds the joint to an object's body."""
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=f"{name}:hinge", type=hinge, pos=self.anchor, **_joint(self, damping))


@dataclass(frozen=True)
class Slide:
    """A joint along which an object slides, as a drawer does. Its name is `<name>:slide`.

    Attributes:
        axis: (3,) direction in the floor's frame.
        range: (low, high) metres between which it slides, from where it was placed; None slides without end.
    """

    axis: Sequence[float] = (1.0, 0.0, 0.0)
    range: Sequence[float] | None = None

    def __post_init__(self) -> None:
        _check_joint(self.axis, self.range, "metres")

    def write(self, body: mujoco.MjsBody, name: str, damping: float) -> None:
        """Adds the joint to an object's body."""
        body.add_joint(name=f"{name}:slide", type=mujoco.mjtJoint.mjJNT_SLIDE, **_joint(self, damping))


Joint = Hinge | Slide


def _check_joint(axis: Sequence[float], range_: Sequence[float] | None, unit: str) -> None:
    if not check_vector("axis", axis, 3, "three numbers, the direction of the axis").any():
        raise ValueError(f"axis: got {axis!r}; takes three numbers that are not all zero")
    if range_ is not None:
        low, high = check_vector("range", range_, 2, f"(low, high) in {unit}, or None")
        if not low < high:
            raise ValueError(f"range: got {range_!r}; takes (low, high) in {unit} with low < high, or None")


def _joint(joint: Joint, damping: float) -> dict[str, Any]:
    limits = {} if joint.range is None else {"range": joint.range, "limited": mujoco.mjtLimited.mjLIMITED_TRUE}
    return {"axis": joint.axis, "damping": (damping, 0, 0), **limits}


def add_body(
    spec: mujoco.MjSpec, name: str, centre: np.ndarray, *, joint: Joint | None = None, free: bool, damping: float
) -> mujoco.MjsBody:
    """Adds a movable body with joints `<name>:x|y|z|yaw`, one `<name>:free`, or a joint of its own.

    Args:
        spec: the spec to write to.
        name: the body's name.
        centre: the body's position in metres, (3,).
        joint: its only joint.
        free: whether to add one free joint instead of three slides and a yaw hinge.
        damping: damping of every joint (N s/m, Nm s/rad); MuJoCo ignores 0.
    """
    body = spec.worldbody.add_body(name=name, pos=centre)
    if joint is not None:
        joint.write(body, name, damping)
        return body
    if free:
        body.add_joint(name=f"{name}:free", type=mujoco.mjtJoint.mjJNT_FREE, damping=(damping, 0, 0))
        return body
    for axis, (label, direction) in enumerate(SLIDES.items()):
        body.add_joint(
            name=f"{name}:{label}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=direction,
            damping=(damping, 0, 0),
            ref=float(centre[axis]),
        )
    body.add_joint(name=f"{name}:yaw", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1), damping=(damping, 0, 0))
    return body


def refer_slides(body: mujoco.MjsBody, centre: np.ndarray) -> None:
    """Sets `ref` of an existing body's world-aligned slides, so that their qpos is the position `centre` (m)."""
    for joint in body.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            joint.ref = float(np.dot(joint.axis, centre))
