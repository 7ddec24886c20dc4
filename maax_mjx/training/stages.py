"""The stages of Baker et al.'s autocurriculum, as bounds on what a game counts.

A stage is reached by what policies do against themselves. That tools are its cause is shown by interventions, which
these numbers are not. The bounds were set before any long run, from what random play gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

PREFIX = "episode_"
"""Of the game's numbers among an iteration's metrics."""


class Stage(NamedTuple):
    """A stage.

    Attributes:
        name: what is done in it.
        bounds: the lowest and the highest value of each number, None where there is none.
    """

    name: str
    bounds: Mapping[str, tuple[float | None, float | None]]

    def holds(self, numbers: Mapping[str, float]) -> bool:
        """Whether all its numbers are there, and within their bounds."""
        return all(
            name in numbers
            and (low is None or numbers[name] >= low)
            and (high is None or numbers[name] <= high)
            for name, (low, high) in self.bounds.items()
        )  # fmt: skip


RAMPS_USED = Stage("ramps used", {"breach": (0.3, None), "elevated": (0.3, None), "seekers_carried_ramp": (0.7, None)})
STAGES: dict[str, tuple[Stage, ...]] = {
    "hide_and_seek_quadrant": (
        Stage(
            "doors blocked",
            {
                "seen": (None, 0.4), "enclosed_prep": (0.5, None), "doors_blocked_prep": (0.7, None),
                "boxes_locked_prep": (1.0, None), "max_box_move_prep": (0.5, None),
            },
        ),
        RAMPS_USED,
        Stage(
            "ramps carried in",
            {"ramp_inside_prep": (0.6, None), "max_ramp_move_prep": (0.8, None), "breach": (None, 0.15)},
        ),
    ),
    "hide_and_seek_full": (
        Stage("forts", {"seen": (None, 0.45), "enclosed_prep": (0.4, None), "boxes_locked_prep": (2.5, None)}),
        RAMPS_USED,
        Stage("ramps locked", {"ramps_locked_prep": (1.5, None), "breach": (None, 0.15)}),
    ),
}  # fmt: skip
"""By game, the stages after chasing and fleeing, which are told by play against random agents."""


def stage_reached(game: str, numbers: Mapping[str, float]) -> str:
    """Returns the name of the furthest stage that a game's numbers hold; "" for none.

    Args:
        game: name of the game.
        numbers: means over episodes by name, as `TrackStats` and `TrackTools` give them.
    """
    held = [stage.name for stage in STAGES.get(game, ()) if stage.holds(numbers)]
    return held[-1] if held else ""


def stage_of(game: str, metrics: Mapping[str, float]) -> str:
    """Returns the name of the furthest stage that an iteration's metrics hold; "" for none.

    Args:
        game: name of the game.
        metrics: numbers by name, those of ended episodes as "episode_...".
    """
    ended = {name.removeprefix(PREFIX): x for name, x in metrics.items() if name.startswith(PREFIX)}
    return stage_reached(game, ended)
