"""Marks of locked objects: a padlock in the colour of who locked it."""

from __future__ import annotations

import numpy as np

from maax_mjx.common.colours import Colour
from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.viewer.palette import DARK
from maax_mjx.viewer.scene import up
from maax_mjx.wrappers import LockObjects

TINT = 0.4
"""Share of its owner's colour in a locked object."""


@marks_of(LockObjects)
def draw_locks(layer: LockObjects, state: State, canvas: Canvas) -> None:
    """A padlock with its owner's number on every locked object, which takes some of the owner's colour."""
    slots = [(module, slot) for module in layer.modules for slot in range(module.n_max)]
    owners = np.asarray(state.mechanics[layer.name].owner)
    for (module, slot), owner in zip(slots, owners, strict=True):
        if owner < 0 or not state.world.active[module.kind][slot]:
            continue
        name, top, colour = module.names[slot], canvas.top(module, slot), canvas.colours[owner]
        canvas.tint(module.kind, slot, colour, TINT)
        _draw_padlock(canvas, name, top + up(0.03), colour)
        canvas.label(name, str(canvas.subject.numbers[owner]), top + up(0.36), colour, role="lock")


def _draw_padlock(canvas: Canvas, name: str, foot: np.ndarray, rgba: Colour) -> None:
    """A padlock that stands on a place, and faces -y."""
    body, side, top = (0.1, 0.045, 0.075), (0.016, 0.016, 0.05), (0.076, 0.016, 0.016)
    boxes = [
        ("body", body, [0, 0, body[2]], rgba),
        ("left", side, [-0.06, 0, 0.2], DARK),
        ("right", side, [0.06, 0, 0.2], DARK),
        ("top", top, [0, 0, 0.25], DARK),
        ("keyhole", (0.018, 0.004, 0.03), [0, -body[1], body[2]], DARK),
    ]
    for part, size, at, colour in boxes:
        canvas.solid(f"{name}:{part}", "box", size, foot + at, colour, role="lock")
