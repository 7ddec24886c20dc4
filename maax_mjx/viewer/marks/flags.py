"""Marks of capture the flag: flags, who is out, the score."""

from __future__ import annotations

import numpy as np

from maax_mjx.core.state import State
from maax_mjx.modules import Flags
from maax_mjx.viewer.canvas import Canvas
from maax_mjx.viewer.marks.registry import marks_of
from maax_mjx.viewer.palette import DARK
from maax_mjx.viewer.scene import up
from maax_mjx.wrappers import CaptureTheFlag

POLE = 0.7
"""Metres: the height of a flag's pole."""


@marks_of(CaptureTheFlag)
def draw_flags(layer: CaptureTheFlag, state: State, canvas: Canvas) -> None:
    """Every flag at its base or over its carrier, bases in the colours of the teams, agents that are out darkened."""
    game = state.mechanics[layer.name]
    carriers = np.asarray(game.carrier).tolist()
    for number, (team, carrier) in enumerate(zip(canvas.subject.teams.values(), carriers, strict=True)):
        foot = np.asarray(state.world.sites[Flags.kind][number], float)
        if carrier >= 0:
            foot = canvas.position(carrier) + up(0.1)
        pole, cloth = foot + up(POLE / 2), foot + np.array([0.16, 0.0, POLE - 0.1])
        canvas.solid(f"{number}:pole", "cylinder", (0.015, POLE / 2), pole, DARK, role="flag")
        canvas.solid(f"{number}:cloth", "box", (0.16, 0.01, 0.1), cloth, team.colour, role="flag")
        canvas.tint(Flags.kind, number, team.colour, 1.0)
    for agent in np.flatnonzero(np.asarray(game.out)).tolist():
        canvas.dim(agent)
    scores = zip(canvas.subject.teams, np.asarray(game.score).tolist(), strict=True)
    canvas.write("score  " + " : ".join(f"{team} {score}" for team, score in scores))
