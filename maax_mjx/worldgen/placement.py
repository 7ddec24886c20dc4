"""Placements: the parts of an object that hold its children."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


class WorldFullError(RuntimeError):
    """An object that found no room inside its placement."""


@dataclass(frozen=True)
class Placement:
    """An axis-aligned box, relative to its object's lower corner, that holds children.

    Attributes:
        origin: (3,) metres, the lower corner. Children stand on its height.
        size: (3,) metres, the extents; inf is open above.
        stacked: whether children are put on top of each other along z with a gap, instead of side by side.
    """

    origin: np.ndarray
    size: np.ndarray
    stacked: bool = False


def choose_placement(wanted: str, names: Iterable[str], owner: str, rng: np.random.Generator) -> str:
    """Returns the placement of that name; else draws one of those whose names begin with it (OpenAI's worldgen).

    Raises:
        ValueError: no such placement; the message names the object, `owner`, and its placements.
    """
    names = list(names)
    matches = [name for name in names if name.startswith(wanted)]
    if not matches:
        raise ValueError(f"placement_name: {owner} has no placement {wanted!r}; takes one of {sorted(names)}")
    if wanted in matches or len(matches) == 1:
        return wanted if wanted in matches else matches[0]
    return matches[int(rng.integers(len(matches)))]
