"""Default poses: the values of joints with which a world begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from maax_mjx.worldgen.annotations import MAIN
from maax_mjx.worldgen.checks import check_vector

KEYFRAME = "start"
"""Name of the keyframe of a world's default poses."""
BALL, FREE, SLIDE = mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_SLIDE


def check_default_qpos(value: Any, source: mujoco.MjSpec) -> dict[str, np.ndarray]:
    """Returns the default poses of a file's joints by name, (1,) each, or (4,) of ball joints.

    Args:
        value: the poses by joint; None is none.
        source: the file.

    Raises:
        ValueError: no dict, a joint that the file lacks or whose place is given otherwise, or a value that is none.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError(f"default_qpos: got {value!r}; takes a dict from joints to their values, or None")
    joints = {joint.name: joint for joint in source.joints if joint.name and not _is_placed(joint)}
    poses = {}
    for name, pose in value.items():
        if name not in joints:
            raise ValueError(
                f"default_qpos: got a value for {name!r}; takes joints of the file, except the slides and the free "
                f"joint of {MAIN!r}: {sorted(joints)}"
            )
        poses[name] = _checked(f"default_qpos[{name!r}]", pose, is_ball=joints[name].type == BALL)
    return poses


def with_default_poses(model: mujoco.MjModel, poses: Mapping[str, np.ndarray]) -> np.ndarray:
    """Returns qpos0 (nq,) of a model, with the default poses of some joints.

    Raises:
        ValueError: a joint that the model does not have, as one that a transform removed, or a value outside its range.
    """
    qpos = model.qpos0.copy()
    for name, pose in poses.items():
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) < 0:
            raise ValueError(f"default_qpos: got a value for {name!r}, which the world does not have; takes its joints")
        joint = model.joint(name)
        low, high = joint.range
        if model.jnt_limited[joint.id] and len(pose) == 1 and not low <= pose[0] <= high:
            raise ValueError(
                f"default_qpos: got {pose[0]:g} for {name!r}; takes a value in its range [{low:g}, {high:g}]"
            )
        start = int(joint.qposadr[0])
        qpos[start : start + len(pose)] = pose
    return qpos


def _is_placed(joint: mujoco.MjsJoint) -> bool:
    """Whether an object's placement gives the joint's value."""
    return joint.parent.name == MAIN and joint.type in (SLIDE, FREE)


def _checked(name: str, pose: float | Sequence[float], is_ball: bool) -> np.ndarray:
    if is_ball:
        quat = check_vector(name, pose, 4, "a quaternion: four numbers, not all zero, w first")
        if not quat.any():
            raise ValueError(f"{name}: got {pose!r}; takes a quaternion: four numbers, not all zero, w first")
        return quat / np.linalg.norm(quat)
    one = pose if np.ndim(pose) else [pose]
    return check_vector(name, one, 1, "a number, in radians of a hinge or metres of a slide")
