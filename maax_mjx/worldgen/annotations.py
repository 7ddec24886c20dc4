"""Annotations of MJCF files: bodies whose box geoms mark bounds and placements, and which the model leaves out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

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


def read_annotations(source: mujoco.MjSpec, file: Path) -> Annotations:
    """Reads the annotations of an object.

    Raises:
        ValueError: MuJoCo refuses the file, a body is missing or outside of the object, or one is turned or lacks its
            box.
    """
    for name in (OUTER_BOUND, MAIN):
        if source.body(name) is None:
            raise ValueError(f"path: got {file} without a body {name!r}; takes one that has it")
    world = source.worldbody
    others = [element.name for element in [*world.bodies, *world.geoms] if not element.name.startswith(PREFIX)]
    if others != [MAIN]:
        raise ValueError(f"path: {file} has {others} at its top; takes one body {MAIN!r}, which holds the rest")
    # MuJoCo computes the bodies' positions, whatever frames, defaults and angles the file uses.
    whole = source.copy()
    whole.compiler.fusestatic = whole.compiler.discardvisual = False
    try:
        model = whole.compile()
    except ValueError as error:
        raise ValueError(f"path: got {file}; takes a model that MuJoCo compiles ({error})") from error
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if not np.allclose(data.body(MAIN).xmat, np.eye(3).ravel()):
        raise ValueError(f"path: the body {MAIN!r} of {file} is turned; takes one without rotation")
    names = [body.name for body in source.bodies if body.name.startswith(PREFIX)]
    boxes = {name: _box(model, data, name, file) for name in names}
    centre, size = boxes.pop(OUTER_BOUND)
    placements = {
        name.removeprefix(PREFIX): Placement(middle - extents / 2 - (centre - size / 2), extents)
        for name, (middle, extents) in boxes.items()
    }
    return Annotations(size, data.body(MAIN).xpos - centre, placements)


def _box(model: mujoco.MjModel, data: mujoco.MjData, name: str, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns centre and extents of a body's box in metres, (3,) each."""
    body = model.body(name)
    geom = int(body.geomadr[0])
    if body.geomnum[0] != 1 or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_BOX:
        raise ValueError(f"path: the body {name!r} of {file} has no box geom; takes one box")
    if not np.allclose(data.geom_xmat[geom], np.eye(3).ravel()):
        raise ValueError(f"path: the box of {name!r} of {file} is turned; takes one without rotation")
    return data.geom_xpos[geom].copy(), 2 * model.geom_size[geom]
