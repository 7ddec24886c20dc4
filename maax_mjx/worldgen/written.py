"""What one object wrote into the spec: what its marks, material and transforms act on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np


@dataclass
class Written:
    """What an object itself wrote, without its children.

    Attributes:
        spec: the whole spec.
        body: the body that holds the geoms. A static object has none of its own: it is its parent's body, and the
            world's for what stands on the floor.
        geoms: of the object.
        joints: of the object.
        sites: of the object, its marks among them.
    """

    spec: mujoco.MjSpec
    body: mujoco.MjsBody
    geoms: list[mujoco.MjsGeom] = field(default_factory=list)
    joints: list[mujoco.MjsJoint] = field(default_factory=list)
    sites: list[mujoco.MjsSite] = field(default_factory=list)

    @classmethod
    def below(cls, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> Written:
        """Everything in a body and in the bodies below it."""
        parts = (list(body.find_all(kind)) for kind in ("geom", "joint", "site"))
        return cls(spec, body, *parts)

    def delete_joint(self, joint: mujoco.MjsJoint) -> None:
        """Takes a joint out of the model, and the actuators that drive it: without it they would not compile."""
        for actuator in self.spec.actuators:
            if actuator.trntype in JOINT_DRIVES and actuator.target == joint.name:
                self.spec.delete(actuator)
        self.joints.remove(joint)
        self.spec.delete(joint)


Transform = Callable[[Written], None]
JOINT_DRIVES = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def body_position(body: mujoco.MjsBody) -> np.ndarray:
    """The position (m) of an unturned body in the floor frame, (3,)."""
    position = np.zeros(3)
    while body is not None:
        position = position + body.pos
        body = body.parent
    return position
