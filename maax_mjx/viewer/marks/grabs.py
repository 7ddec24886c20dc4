"""Marks of held objects: hands that reach for them, and a bar from agent to object."""

from __future__ import annotations

import numpy as np

from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.viewer.palette import DARK
from maax_mjx.viewer.scene import turned, up
from maax_mjx.wrappers import GrabObjects

HAND, BETWEEN, REACH = 0.05, 0.07, 0.19
"""Metres: the radius of a hand, and where the two of an agent that holds something are, sideways and ahead."""


@marks_of(GrabObjects)
def draw_holds(layer: GrabObjects, state: State, canvas: Canvas) -> None:
    """The hands of an agent that holds something on that side, and a bar over the object's upper side to the agent."""
    slots = [(module, slot) for module in layer.modules for slot in range(module.n_max)]
    held = np.asarray(state.mechanics[layer.name].held)
    for agent in canvas.playing:
        if held[agent] < 0:
            continue
        module, slot = slots[held[agent]]
        name, here = canvas.subject.agents.names[agent], canvas.position(agent)
        to = canvas.centre(module, slot) - here
        reach = turned(float(np.arctan2(to[1], to[0])))
        for side, sign in (("left", 1), ("right", -1)):
            position = here + reach @ [REACH, BETWEEN * sign, 0.0]
            canvas.replace(f"{name}:hand_{side}", "sphere", (HAND,), position, canvas.colours[agent])
        there = canvas.top(module, slot) + up(0.03)
        above = np.array([here[0], here[1], max(there[2], here[2] + 0.16)])
        ends = [[above, there], [above, here + up(0.14)]]
        canvas.line(name, ends, DARK, width=0.035, role="hold")
