"""Annotations of MJCF files: bodies whose box geoms mark bounds and placements, and which the model leaves out."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from maax_mjx.worldgen.placement import Placement

MAIN = "main"
PREFIX = "annotation:"
OUTER_BOUND = f"{PREFIX}outer_bound"


@dataclass(frozen=True)
class Annotations:
    """The annotations of a file.

    Attributes:
        size: (3,) metres, the object's extents.
        main: (3,) metres, position of the body "main" from the centre of the bounding box.
        placements: placements by name, relative to the lower corner of the bounding box.
    """

    size: np.ndarray
    main: np.ndarray
    placements: dict[str, Placement]


def read_annotations(source: mujoco.MjSpec, where: str) -> Annotations:
    """Reads the annotations of an object.

    Args:
        source: the object's file.
        where: what messages call it.

    Raises:
        ValueError: MuJoCo refuses the file, a body is missing or outside of the object, or one is turned or lacks its
            box.
    """
    for name in (OUTER_BOUND, MAIN):
        if source.body(name) is None:
            raise ValueError(f"source: got {where} without a body {name!r}; takes one that has it")
    world = source.worldbody
    others = [element.name for element in [*world.bodies, *world.geoms] if not element.name.startswith(PREFIX)]
    if others != [MAIN]:
        raise ValueError(f"source: {where} has {others} at its top; takes one body {MAIN!r}, which holds the rest")
    # MuJoCo computes the bodies' positions, whatever frames, defaults and angles the file uses.
    whole = source.copy()
    whole.compiler.fusestatic = whole.compiler.discardvisual = False
    try:
        model = whole.compile()
    except ValueError as error:
        raise ValueError(f"source: got {where}; takes a model that MuJoCo compiles ({error})") from error
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if not np.allclose(data.body(MAIN).xmat, np.eye(3).ravel()):
        raise ValueError(f"source: the body {MAIN!r} of {where} is turned; takes one without rotation")
    names = [body.name for body in source.bodies if body.name.startswith(PREFIX)]
    boxes = {name: _box(model, data, name, where) for name in names}
    centre, size = boxes.pop(OUTER_BOUND)
    placements = {
        name.removeprefix(PREFIX): Placement(middle - extents / 2 - (centre - size / 2), extents)
        for name, (middle, extents) in boxes.items()
    }
    return Annotations(size, data.body(MAIN).xpos - centre, placements)


def _box(model: mujoco.MjModel, data: mujoco.MjData, name: str, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns centre and extents of a body's box in metres, (3,) each."""
    body = model.body(name)
    geom = int(body.geomadr[0])
    if body.geomnum[0] != 1 or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
        raise ValueError(f"source: the body {name!r} of {where} has no box geom; takes one box")
    if not np.allclose(data.geom_xmat[geom], np.eye(3).ravel()):
        raise ValueError(f"source: the box of {name!r} of {where} is turned; takes one without rotation")
    return data.geom_xpos[geom].copy(), 2 * model.geom_size[geom]
