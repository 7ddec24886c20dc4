"""Marks of senses, where a picture is asked for them: cones of vision, who sees whom, lidar rays."""

from __future__ import annotations

import jax
import numpy as np

from maax_mjx.core.state import State
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.viewer.scene import turned
from maax_mjx.wrappers import Lidar, LineOfSight

CONE_REACH = 1.5
"""Metres to which cones of vision are drawn; what agents see does not end there."""
CONE_OPACITY, RAY_OPACITY = 0.2, 0.6


@marks_of(LineOfSight, sense="vision")
def draw_sight(layer: LineOfSight, state: State, canvas: Canvas) -> None:
    """The cone ahead of every agent that sees at all, and lines to the others that it sees of other teams."""
    subject = canvas.subject
    sees = np.asarray(state.mechanics[layer.name][f"sees_{subject.agents.kind}"])
    for agent in canvas.playing:
        # Agents see themselves unless they see nothing at all.
        if not sees[agent, agent]:
            continue
        name, here, colour = subject.agents.names[agent], canvas.position(agent), canvas.colours[agent]
        # Cones that overlap lie at different heights.
        on_floor = [here[0], here[1], 0.012 + 0.003 * agent]
        canvas.solid(
            name, "sector", (CONE_REACH, float(layer.half_cone)), on_floor, (*colour[:3], CONE_OPACITY),
            rotation=turned(canvas.heading(agent)), role="cone",
        )  # fmt: skip
        others = np.flatnonzero(sees[agent] & (subject.team != subject.team[agent])).tolist()
        if others:
            ends = [[here, canvas.position(other)] for other in others]
            canvas.line(name, ends, colour, width=0.02, role="sight")


@marks_of(Lidar, sense="lidar")
class LidarRays:
    """Draws the rays of every agent to where they end.

    Args:
        layer: the lidar.
    """

    def __init__(self, layer: Lidar):
        self._cast = jax.jit(layer.rays)

    def __call__(self, state: State, canvas: Canvas) -> None:
        """Adds the rays of a state."""
        directions, distances = (np.asarray(x, float) for x in jax.device_get(self._cast(state)))
        for agent in canvas.playing:
            here = canvas.position(agent)
            ends = here + directions[agent] * distances[agent][:, None]
            points = np.stack([np.broadcast_to(here, ends.shape), ends], axis=1)
            colour = (*canvas.colours[agent][:3], RAY_OPACITY)
            canvas.line(canvas.subject.agents.names[agent], points, colour, width=0.008, role="ray")
