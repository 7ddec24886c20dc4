"""The table of an environment's observations, for people."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from gymnasium import spaces

from maax_mjx.common.observed import Column, Observed

MANY = 24
"""Columns beyond which they are counted instead of listed."""
UNDECLARED = "undeclared: all agents, in raw observations alone"


class Row(NamedTuple):
    """One observation.

    Attributes:
        name: of the array.
        axes: what its axes count, in words.
        shape: of the array, of one world.
        columns: what stands along its last axis, with units, in words.
        whose: who sees it, in words.
    """

    name: str
    axes: str
    shape: tuple[int, ...]
    columns: str
    whose: str


class Description(tuple[Row, ...]):
    """The rows of the table; its text is the table itself."""

    def __str__(self) -> str:
        head = ("name", "axes", "shape", "who sees it", "columns")
        cells = [head, *((row.name, row.axes, str(row.shape), row.whose, row.columns) for row in self)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(head) - 1)]
        lines = ["  ".join([*(cell.ljust(n) for cell, n in zip(row, widths, strict=False)), row[-1]]) for row in cells]
        return "\n".join(line.rstrip() for line in lines)

    __repr__ = __str__


def describe(observed: Mapping[str, Observed], space: spaces.Dict) -> Description:
    """The table of what is observed.

    Args:
        observed: what is declared.
        space: of the observations.
    """
    rows = []
    for name, sub in space.spaces.items():
        shape = sub.shape or ()
        one = observed.get(name)
        if one is None:
            rows.append(Row(name, "", shape, "", UNDECLARED))
        else:
            rows.append(Row(name, " x ".join(one.axes), shape, in_words(one.columns), one.whose()))
    return Description(rows)


def in_words(columns: tuple[Column, ...]) -> str:
    """Columns with their units, each unit once for several in a row: "x, y, z (m), cos yaw, sin yaw".

    Of the many columns of a flat vector, how many belong to which array: "24 of agent_qpos_qvel, 9 of box_obs".
    """
    if len(columns) > MANY:
        counts = Counter(re.split(r"[\[ ]", column.name)[0] for column in columns)
        return ", ".join(f"{n} of {name}" for name, n in counts.items())
    parts: list[tuple[list[str], str]] = []
    for column in columns:
        if parts and parts[-1][1] == column.unit:
            parts[-1][0].append(column.name)
        else:
            parts.append(([column.name], column.unit))
    return ", ".join(", ".join(names) + (f" ({unit})" if unit else "") for names, unit in parts)
