"""Colours of what pictures show besides teams, and how colours mix."""

from __future__ import annotations

from collections.abc import Sequence

from maax_mjx.common.colours import Colour, colour

DOOR = colour("#009e73")
IT = colour("#f0e442")
GRID = colour("#dedcd3")
HIGH_WALL, WALL = colour("#6b7078"), colour("#a9adb3")
DARK = colour("#333333")
EYE = colour("#1d1d1f")
SKY = colour("#ffffff")


def blend(one: Sequence[float], other: Sequence[float], share: float) -> Colour:
    """A colour with a share in [0, 1] of another; its own opacity stays."""
    red, green, blue = (a * (1 - share) + b * share for a, b in zip(one[:3], other[:3], strict=True))
    return float(red), float(green), float(blue), float(one[3])


def as_bytes(one: Sequence[float]) -> tuple[int, int, int]:
    """Red, green and blue in 0 to 255."""
    red, green, blue = (round(255 * float(value)) for value in one[:3])
    return red, green, blue
