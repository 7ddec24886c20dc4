"""The part of the spec that one object wrote, on which its marks, material and transforms act."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np


@dataclass
class Written:
    """The part of the spec that an object itself wrote, without its children.

    Attributes:
        spec: the whole spec.
        body: the body that holds the geoms. For a static object it is its parent's body, or the world's if it stands on
            the floor.
        geoms: the object's geoms.
        joints: the object's joints.
        sites: the object's sites, including its marks.
    """

    spec: mujoco.MjSpec
    body: mujoco.MjsBody
    geoms: list[mujoco.MjsGeom] = field(default_factory=list)
    joints: list[mujoco.MjsJoint] = field(default_factory=list)
    sites: list[mujoco.MjsSite] = field(default_factory=list)

    @classmethod
    def below(cls, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> Written:
        """Returns everything in a body and in the bodies below it."""
        parts = (list(body.find_all(kind)) for kind in ("geom", "joint", "site"))
        return cls(spec, body, *parts)

    def delete_joint(self, joint: mujoco.MjsJoint) -> None:
        """Removes a joint from the model, with the actuators that drive it, which would not compile without it."""
        for actuator in self.spec.actuators:
            if actuator.trntype in JOINT_DRIVES and actuator.target == joint.name:
                self.spec.delete(actuator)
        self.joints.remove(joint)
        self.spec.delete(joint)


Transform = Callable[[Written], None]
"""What changes a part that was written to a model, such as its colour or mass."""
JOINT_DRIVES = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def body_position(body: mujoco.MjsBody) -> np.ndarray:
    """Returns the position (3,) in metres of an unturned body in the floor frame."""
    position = np.zeros(3)
    while body is not None:
        position = position + body.pos
        body = body.parent
    return position
