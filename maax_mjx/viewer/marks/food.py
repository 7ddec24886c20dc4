"""Marks of food: how much is left."""

from __future__ import annotations

import numpy as np

from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.viewer.palette import DARK
from maax_mjx.wrappers import EatFood


@marks_of(EatFood)
def draw_food(layer: EatFood, state: State, canvas: Canvas) -> None:
    """Pieces darken as they are eaten, and how much was eaten is written."""
    meals = state.mechanics[layer.name]
    for slot in np.flatnonzero(np.asarray(state.world.active[layer.food.kind])).tolist():
        left = float(meals.health[slot]) / layer.max_health
        canvas.tint(layer.food.kind, slot, DARK, min(max(1 - left, 0.0), 1.0))
    canvas.write(f"eaten {float(np.asarray(meals.eaten).sum()):g}")
