"""A readable table of an environment's observations."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from gymnasium import spaces

from maax_mjx.common.observed import Column, Observed

MANY = 24
"""Columns of an observation from which on they are counted instead of listed."""
UNDECLARED = "undeclared: all agents, in raw observations alone"


class Row(NamedTuple):
    """One row of the table, for one observation.

    Attributes:
        name: name of the array.
        axes: names of its axes, joined to text.
        shape: its shape in one world.
        columns: names and units of its columns, joined to text.
        whose: text that says who sees it.
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
    """Makes the table of an environment's observations.

    Args:
        observed: the declarations, by name.
        space: the observation space.
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
    """Returns text for columns, with each unit once per run: "x, y, z (m), cos yaw, sin yaw".

    Many columns, as in a flat vector, are counted by array instead: "24 of agent_qpos_qvel, 9 of box_obs".
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
