"""Marks of agents: eyes, a line ahead for plans, and their number."""

from __future__ import annotations

from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.palette import DARK, EYE
from maax_mjx.viewer.scene import turned, up


def draw_agents(state: State, canvas: Canvas) -> None:
    """Two eyes and a heading for every agent in play, and its name."""
    subject = canvas.subject
    for agent in canvas.playing:
        name, centre, rotation = subject.agents.names[agent], canvas.position(agent), turned(canvas.heading(agent))
        for side, sign in (("left", 1), ("right", -1)):
            position = centre + rotation @ [0.117, 0.058 * sign, 0.075]
            canvas.solid(f"{name}:eye_{side}", "sphere", (0.028,), position, EYE, role="eye")
        ends = [centre, centre + 0.28 * rotation[:, 0]]
        canvas.line(f"{name}:heading", ends, DARK, width=0.02, role="heading")
        own = subject.env.agent_names[agent]
        canvas.label(f"{name}:name", own, centre + up(0.26), canvas.colours[agent], role="name")
