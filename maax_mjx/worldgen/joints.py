"""Joints of movable objects, in absolute coordinates.

`ref` makes qpos the position of the body itself: a slide's qpos is the body's coordinate in metres in the floor frame,
like a free joint's, and the model's default configuration is where the object was placed.
"""

from __future__ import annotations

import mujoco
import numpy as np

SLIDES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


def add_body(spec: mujoco.MjSpec, name: str, centre: np.ndarray, *, free: bool, damping: float) -> mujoco.MjsBody:
    """Adds a movable body with joints `<name>:x|y|z|yaw`, or one `<name>:free`.

    Args:
        spec: the spec to write to.
        name: the body's name.
        centre: the body's position in metres, (3,).
        free: whether to add one free joint instead of three slides and a yaw hinge.
        damping: damping of every joint (N s/m, Nm s/rad); MuJoCo ignores 0.
    """
    body = spec.worldbody.add_body(name=name, pos=centre)
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
