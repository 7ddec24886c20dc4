"""Marks of ramps: arrows uphill, since slopes are hard to see from some sides."""

from __future__ import annotations

import numpy as np

from maax_mjx.core.state import State
from maax_mjx.modules import Ramps
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.palette import DARK
from maax_mjx.viewer.scene import up


def draw_slopes(state: State, canvas: Canvas) -> None:
    """An arrow up every ramp in play."""
    subject = canvas.subject
    for module in subject.base.modules.values():
        if not isinstance(module, Ramps):
            continue
        for slot in np.flatnonzero(np.asarray(state.world.active[module.kind])):
            geom = int(module.geom_ids[slot])
            rotation = np.asarray(state.data.geom_xmat[geom], float).reshape(3, 3)
            corners = subject.meshes[int(subject.model.geom_dataid[geom])][0] @ rotation.T
            corners += np.asarray(state.data.geom_xpos[geom], float)
            foot, tip = uphill(corners)
            side = np.cross(tip - foot, corners.mean(axis=0) - foot)
            side *= 0.12 / max(float(np.linalg.norm(side)), 1e-9)
            back = foot + 0.6 * (tip - foot)
            ends = [[foot, tip], [tip, back + side], [tip, back - side]]
            canvas.line(f"{module.names[slot]}:slope", ends, DARK, width=0.024, role="slope")


def uphill(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) foot and (3,) tip of an arrow on the slope of a wedge, from its corners (n, 3) in metres."""
    upper = np.unique(corners[corners[:, 2] > corners[:, 2].mean()].round(4), axis=0)
    lower = np.unique(corners[corners[:, 2] <= corners[:, 2].mean()].round(4), axis=0)
    top = upper.mean(axis=0)
    # Of the lower corners, the two that are furthest from the upper edge.
    away = np.linalg.norm((lower - top)[:, :2], axis=1)
    bottom = lower[np.argsort(away)[-2:]].mean(axis=0)
    way, lift = top - bottom, up(0.012)
    return bottom + 0.2 * way + lift, bottom + 0.8 * way + lift
