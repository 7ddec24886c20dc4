"""Transforms for `Obj.add_transform`: of an object, or with a `WorldBuilder` of the whole world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from maax_mjx.worldgen.checks import check_choice, check_number, check_vector
from maax_mjx.worldgen.written import Transform, Written

JOINTS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
    "free": mujoco.mjtJoint.mjJNT_FREE,
}
WITH_AXIS = (JOINTS["hinge"], JOINTS["slide"])


def set_geom_attr(name: str, value: Any) -> Transform:
    """Sets an attribute of every geom.

    Args:
        name: attribute of `mujoco.MjsGeom` ("friction", "rgba", "condim", "margin").
        value: its value; three numbers for "friction".

    Raises:
        ValueError: a geom has no such attribute, or it does not take the value.
    """
    spec = mujoco.MjSpec()  # the value is tried on a geom of this spec; the name keeps it alive
    probe = spec.worldbody.add_geom()
    if not isinstance(name, str) or name.startswith("_") or not hasattr(probe, name):
        takes = [attr for attr in dir(probe) if not attr.startswith("_")]
        raise ValueError(f"name: got {name!r}; takes an attribute of a geom, one of {takes}")
    try:
        setattr(probe, name, value)
    except (TypeError, ValueError, AttributeError) as error:
        kind = type(getattr(probe, name)).__name__
        raise ValueError(f"value: got {value!r}; a geom's {name!r} does not take it: it is of type {kind}") from error

    def transform(written: Written) -> None:
        for geom in written.geoms:
            setattr(geom, name, value)

    return transform


def set_joint_damping(damping: float, contains: str = "") -> Transform:
    """Sets the damping of every joint whose name contains a word.

    Args:
        damping: at least 0, in N s/m for slides and Nm s/rad for hinges.
        contains: part of the joint's name (":yaw"); "" matches every joint. A world may have none.

    Raises:
        ValueError: a negative damping.
    """
    check_number("damping", damping, "a number of at least 0, in N s/m or Nm s/rad")

    def transform(written: Written) -> None:
        for joint in written.joints:
            if contains in joint.name:
                # Linear in the velocity: MuJoCo's coefficients of the higher powers are zero.
                joint.damping = (damping, 0, 0)

    return transform


def remove_joints(joint_type: str | None = None, axis: Sequence[float] | None = None) -> Transform:
    """Removes joints from the model, with the actuators that drive them.

    `remove_joints("hinge", (0, 0, 1))` keeps a box from turning, `remove_joints("slide", (0, 0, 1))` from rising.

    Args:
        joint_type: "hinge", "slide", "ball" or "free"; None is every type.
        axis: (3,) direction, for hinges and slides along or against it; None is every axis.

    Raises:
        ValueError: an unknown type, a zero axis, or an axis for joints that have none.
    """
    if joint_type is not None:
        check_choice("joint_type", joint_type, list(JOINTS))
    direction = None
    if axis is not None:
        direction = check_vector("axis", axis, 3, "three numbers, not all zero")
        if not direction.any() or joint_type in ("ball", "free"):
            takes = "three numbers, not all zero, and only for hinges and slides"
            raise ValueError(f"axis: got {axis!r} with joint_type={joint_type!r}; takes {takes}")

    def matches(joint: mujoco.MjsJoint) -> bool:
        if joint_type is not None and joint.type != JOINTS[joint_type]:
            return False
        return direction is None or (joint.type in WITH_AXIS and _parallel(joint.axis, direction))

    def transform(written: Written) -> None:
        for joint in [joint for joint in written.joints if matches(joint)]:
            written.delete_joint(joint)

    return transform


def _parallel(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.linalg.norm(np.cross(a, b)) <= 1e-6 * np.linalg.norm(a) * np.linalg.norm(b))
