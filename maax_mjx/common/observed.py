"""Declarations of observations, by modules and wrappers: axes, columns and who sees them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import jax
import numpy as np

from maax_mjx.common.checks import described

AGENT = "agent"
"""Name of the axis of agents."""


@dataclass(frozen=True)
class Column:
    """One column of an observation.

    Attributes:
        name: the column's name; `EgocentricObservations` gives some a meaning: `POSITION`, `TURN`, `VELOCITY`.
        unit: "m", "rad", "m/s", ...; empty for shares, flags and counts.
        scale: typical size in its unit; networks divide by it.
    """

    name: str
    unit: str = ""
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"name: got {self.name!r}; takes the name of a column")
        if not isinstance(self.unit, str):
            raise ValueError(f"unit: got {self.unit!r} for column {self.name!r}; takes a text")
        if isinstance(self.scale, bool) or not isinstance(self.scale, int | float) or not self.scale > 0:
            raise ValueError(f"scale: got {self.scale!r} for column {self.name!r}; takes a positive number")


POSITION = (Column("x", "m", 3.0), Column("y", "m", 3.0), Column("z", "m", 1.0))
TURN = (Column("cos yaw"), Column("sin yaw"))
YAW = (Column("yaw", "rad", pi),)
ROTATION = tuple(Column(f"{axis}{part}") for axis in ("forward ", "left ") for part in "xyz")
"""The first two columns of a rotation matrix."""
VELOCITY = (Column("vx", "m/s", 3.0), Column("vy", "m/s", 3.0), Column("vz", "m/s", 3.0))
SPIN = (Column("spin", "rad/s", 6.0),)
SPINS = tuple(Column(f"spin {axis}", "rad/s", 6.0) for axis in "xyz")
"""Angular velocity of a free body about its own axes, in radians per second."""
SIZE = tuple(Column(f"size {axis}", "m") for axis in "xyz")


@dataclass(frozen=True)
class Observed:
    """The declaration of one array of observations.

    The array's shape is one length per axis, followed by the number of columns if it has columns.

    Attributes:
        axes: what each axis counts: "agent", the kind of an entity such as "box", or another name such as "ray". Arrays
            that share an axis describe the same things.
        columns: columns of the last axis; none for masks and plain numbers.
        present: name of the mask of entities in play, along the same axes or the last of them; None finds
            `<kind>_mask`.
        seen: name of the mask of what an agent sees; None finds `sees_<kind>`.
        private: with "agent" as the first axis, whether a row is that agent's own; otherwise others see it too.
        derived: whether other arrays hold the same information; such arrays are left out of what agents learn from.
        critic: whether it is only for a value function, which may see more than any agent.
    """

    axes: tuple[str, ...] = ()
    columns: tuple[Column, ...] = ()
    present: str | None = None
    seen: str | None = None
    private: bool = True
    derived: bool = False
    critic: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.axes, str) or not all(isinstance(axis, str) and axis for axis in self.axes):
            raise ValueError(f"axes: got {self.axes!r}; takes a tuple of names, such as ('agent', 'box')")
        if not all(isinstance(column, Column) for column in self.columns):
            raise ValueError(f"columns: got {self.columns!r}; takes a tuple of Column")
        names = [column.name for column in self.columns]
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"columns: got {twice} twice; takes different names")

    @property
    def is_of_agents(self) -> bool:
        """Whether the array's rows belong to agents."""
        return self.axes[:1] == (AGENT,)

    @property
    def entity(self) -> str | None:
        """Kind of the listed entities: the first axis, or the second where rows belong to agents; None without one."""
        axes = self.axes[1:] if self.is_of_agents and self.private else self.axes
        return axes[0] if axes else None

    def names(self) -> tuple[str, ...]:
        """Returns the names of the columns."""
        return tuple(column.name for column in self.columns)

    def whose(self) -> str:
        """Returns a text that says who sees the array."""
        if self.critic:
            return "critics"
        if self.is_of_agents and self.private:
            return f"each agent its own, where {self.seen}" if self.seen else "each agent its own"
        if self.is_of_agents:
            return f"each agent its own, others' where {self.seen}" if self.seen else "all agents"
        return f"all agents, where {self.seen}" if self.seen else "all agents"


def flag(*names: str) -> tuple[Column, ...]:
    """Returns columns that are 0 or 1, or shares."""
    return tuple(Column(name) for name in names)


def check_axes(table: Mapping[str, Observed]) -> None:
    """Refuses an axis in the plural, which would be another one than that of agents, or of a kind that has a mask."""
    kinds = {AGENT, *(name.removesuffix("_mask") for name in table if name.endswith("_mask"))}
    plurals = {f"{kind}{end}": kind for kind in kinds for end in ("s", "es")}
    for name, one in table.items():
        for axis in one.axes:
            if axis in plurals and axis not in kinds:
                raise ValueError(f"axes: got {axis!r} for {name!r}; takes {plurals[axis]!r}, in the singular")


def resolved(table: Mapping[str, Observed]) -> dict[str, Observed]:
    """Returns the table with the masks of every array filled in, where there are such masks.

    Raises:
        ValueError: something else than declarations, or an axis in the plural.
    """

    def masks(name: str, one: Observed) -> Observed:
        if not isinstance(one, Observed):
            raise ValueError(f"declared: got {one!r} for {name!r}; takes an Observed")
        kind = one.entity
        if kind is None or not one.columns:
            return one
        present = f"{kind}_mask" if f"{kind}_mask" in table else None
        seen = f"sees_{kind}" if f"sees_{kind}" in table else None
        return replace(one, present=one.present or present, seen=one.seen or seen)

    found = {name: masks(name, one) for name, one in table.items()}
    check_axes(found)
    return found


def check_arrays(obs: Any, hook: str, who: str) -> dict[str, jax.Array]:
    """Returns observations, after checking that they are arrays by name.

    Args:
        obs: what a hook returned.
        hook: the hook's name, for the message.
        who: class that it belongs to.

    Raises:
        ValueError: something else than a dict, a name that is no text, or something that is no array.
    """
    if not isinstance(obs, Mapping):
        raise ValueError(f'{hook}: {who} returned {described(obs)}; takes a dict of arrays by name, {{"name": array}}')
    for name, array in obs.items():
        if not isinstance(name, str):
            raise ValueError(f"{hook}: {who} returned an array under {described(name)}; takes names as text")
        if not isinstance(array, jax.Array | np.ndarray):
            raise ValueError(
                f"{hook}: {who} returned {described(array)} as {name!r}; takes an array, such as jnp.asarray(...)"
            )
    return dict(obs)


def check_shapes(table: Mapping[str, Observed], shapes: Mapping[str, tuple[int, ...]], who: str) -> None:
    """Refuses arrays whose shapes do not match their declarations.

    Args:
        table: declarations, of all arrays at least.
        shapes: shapes of the arrays, by name.
        who: the wrapper or command that needs them, for the message.

    Raises:
        ValueError: another number of axes or columns than declared, or two lengths of one axis.
    """
    lengths: dict[str, tuple[int, str]] = {}
    for name, shape in shapes.items():
        one = table[name]
        want = len(one.axes) + bool(one.columns)
        if len(shape) != want:
            takes = f"{want} axes, {(*one.axes, 'columns') if one.columns else one.axes}"
            raise ValueError(f"{who}: {name!r} has shape {shape}; declared are {takes}")
        if one.columns and shape[-1] != len(one.columns):
            raise ValueError(
                f"{who}: {name!r} has {shape[-1]} columns; declared are {len(one.columns)}, {list(one.names())}"
            )
        for axis, length in zip(one.axes, shape, strict=False):
            before, other = lengths.setdefault(axis, (length, name))
            if before != length:
                raise ValueError(f"{who}: axis {axis!r} has length {length} in {name!r} and {before} in {other!r}")


def declaration(name: str, shape: tuple[int, ...], n_agents: int) -> str:
    """A line that would declare an array, guessed from its shape; for messages."""
    n_axes = 1 if shape[:1] == (n_agents,) else 0
    n_axes += shape[:2] == (n_agents, n_agents)
    axes = [AGENT] * n_axes + ["..."] * (len(shape) - n_axes)
    columns = ""
    if len(shape) > max(n_axes, 1):
        axes = axes[:-1]
        columns = f", columns=({''.join(f'Column({chr(34)}...{i}{chr(34)}), ' for i in range(shape[-1])).rstrip()})"
    text = ", ".join(repr(axis) for axis in axes) + ("," if len(axes) == 1 else "")
    return f'{{"{name}": Observed(({text}){columns})}}'
