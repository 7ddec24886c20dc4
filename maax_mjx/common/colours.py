"""Colours that models and pictures share: those of Okabe and Ito, which colour-blind people can distinguish."""

from __future__ import annotations

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity in [0, 1]."""


def colour(text: str, opacity: float = 1.0) -> Colour:
    """Returns the colour that a text such as "#0072b2" names."""
    red, green, blue = (int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue, opacity


GREY: Colour = (0.5, 0.5, 0.5, 1.0)
TEAM_COLOURS = tuple(colour(text) for text in ("#0072b2", "#d55e00", "#cc79a7", "#56b4e9", "#e69f00", "#f0e442"))
"""RGBA of teams without given colours, in the teams' order."""


def team_colour(number: int) -> Colour:
    """Returns the colour of a team without a given one, by its number; after the last one they begin again."""
    return TEAM_COLOURS[number % len(TEAM_COLOURS)]
