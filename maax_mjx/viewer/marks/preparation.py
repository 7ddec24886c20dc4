"""Marks of the preparation phase: how long it lasts, and who waits."""

from __future__ import annotations

import numpy as np

from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.wrappers import PreparationPhase


@marks_of(PreparationPhase)
def draw_preparation(layer: PreparationPhase, state: State, canvas: Canvas) -> None:
    """The time that is left, beside the time, and agents that wait darkened."""
    n_left = layer.n_steps - int(state.step)
    if n_left <= 0:
        return
    canvas.note(f"preparation, {n_left * layer.base.dt:.1f} s left")
    for agent in np.flatnonzero(layer.seekers).tolist():
        canvas.dim(agent)
