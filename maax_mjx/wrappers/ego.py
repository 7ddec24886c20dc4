"""Observations in the agents' own frames."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from maax_mjx.common.arrays import shown
from maax_mjx.common.observed import AGENT, Column, Observed, flag
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.critic import time_left
from maax_mjx.wrappers.senses import Lidar
from maax_mjx.wrappers.split import SplitObservations, declared_table
from maax_mjx.wrappers.wrapper import ObservationWrapper, find

CLIP = 5.0
"""Scales at which numbers are clipped."""
ABSOLUTE = ("floor x", "floor y", "cos heading", "sin heading")
"""Columns that change when the world is turned and shifted: an agent's own place and heading on the floor."""
DISTANCE = Column("distance", "m", 3.0)
FLAT = {
    "x": ("y", "ahead", "to the left"),
    "vx": ("vy", "v ahead", "v to the left"),
    "cos yaw": ("sin yaw", "cos turn", "sin turn"),
    "forward x": ("forward y", "forward ahead", "forward to the left"),
    "left x": ("left y", "left ahead", "left to the left"),
}
"""Columns that are vectors on the floor: by the first column, the second one and the two that they become."""


class Frames(NamedTuple):
    """The agents' frames.

    Attributes:
        position: (n_agents, 2) metres.
        velocity: (n_agents, 2) metres per second.
        heading: (n_agents,) radians, from the world's x.
        floor_size: () metres, the edge of the floor.
    """

    position: jax.Array
    velocity: jax.Array
    heading: jax.Array
    floor_size: jax.Array


class EgocentricObservations(ObservationWrapper):
    """Gives every agent observations in its own frame, whose first axis points ahead, in fixed scales.

    Columns are recognised by name. x and y become how far ahead and to the left something is, and its distance;
    velocities are relative to the agent's, in its frame; yaw, as an angle or as cos and sin, becomes cos and sin of the
    turn relative to the agent. An agent's own columns are its place as a share of the floor, its heading as cos and
    sin, and its velocity in its own frame. Every column is divided by its scale and clipped at 5. Adds `time_left`
    (n_agents, 1). Entities that are not in play are zero; masks stay as they are.

    If a whole world is turned and shifted, only the `ABSOLUTE` columns change.

    Args:
        env: environment to wrap, with split observations; its `Lidar`, if any, is in the agents' frame.

    Raises:
        ValueError: observations that are not split or not declared, or lidar in the world's frame.
    """

    name = "egocentric_observations"
    requires = (SplitObservations,)

    def __init__(self, env: Environment):
        super().__init__(env)
        lidar = find(env, Lidar)
        if lidar is not None and lidar.frame != "agent":
            raise ValueError(
                f"EgocentricObservations: Lidar got frame={lidar.frame!r}; takes Lidar(env, frame='agent') there"
            )
        self._table = declared_table(env, "EgocentricObservations")

    def observation(self, state: State) -> dict[str, jax.Array]:
        frames, playing = self._frames(state), self.playing(state)
        obs = dict(state.obs)
        for name, one in self._table.items():
            if not one.columns:
                continue
            parts = _columns(obs[name], one, frames, own=self._is_own(name))
            scaled = [_scaled(column, x) for column, x in parts]
            x = shown(jnp.stack(scaled, axis=-1).astype(jnp.float32), playing)
            obs[name] = x if one.present is None else shown(x, state.obs[one.present] > 0)
        return obs | {"time_left": time_left(state, self.base.horizon, self.base.n_agents)}

    def declared(self) -> dict[str, Observed]:
        table = self.env.declared()
        for name, one in self._table.items():
            if one.columns:
                columns = _renamed(one, own=self._is_own(name))
                table[name] = replace(table[name], columns=tuple(_in_scales(column) for column in columns))
        return table | {"time_left": Observed((AGENT,), flag("time left"))}

    def _is_own(self, name: str) -> bool:
        """Whether an array holds what agents know of themselves, while another holds what they see of others."""
        return name.endswith("_self") and name.removesuffix("_self") in self._table

    def _frames(self, state: State) -> Frames:
        agents, data = self.base.agents, state.data
        yaw = data.qpos[agents.qpos_ids[:, 3]]
        # At yaw 0 agents face -y.
        return Frames(
            position=data.qpos[agents.qpos_ids[:, :2]],
            velocity=data.qvel[agents.qvel_ids[:, :2]],
            heading=yaw - jnp.pi / 2,
            floor_size=state.world.plan.floor_size,
        )


def _renamed(one: Observed, *, own: bool) -> list[Column]:
    """Returns the columns that an array's columns become."""
    names = one.names()
    pairs = {first: pair for first, pair in FLAT.items() if first in names and pair[0] in names}
    seconds = {pair[0] for pair in pairs.values()}
    columns: list[Column] = []
    for column in one.columns:
        if column.name == "x" and "x" in pairs and own:
            columns += [Column("floor x"), Column("floor y")]
        elif column.name in pairs:
            columns += [replace(column, name=name) for name in pairs[column.name][1:]]
            columns += [DISTANCE] if column.name == "x" else []
        elif column.name == "yaw":
            columns += flag("cos heading", "sin heading") if own else flag("cos turn", "sin turn")
        elif column.name not in seconds:
            columns.append(column)
    return _headings(columns) if own else columns


def _columns(x: jax.Array, one: Observed, frames: Frames, *, own: bool) -> list[tuple[Column, jax.Array]]:
    """Returns the columns of an array (n_agents, ..., n_columns) in the agents' frames, before scaling."""
    lead = (-1, *[1] * (x.ndim - 2))
    named = dict(zip(one.names(), jnp.moveaxis(x, -1, 0), strict=True))
    cos, sin = (f(frames.heading).reshape(lead) for f in (jnp.cos, jnp.sin))
    pairs = {first: pair for first, pair in FLAT.items() if first in named and pair[0] in named}
    seconds = {pair[0] for pair in pairs.values()}
    values: list[jax.Array] = []
    for name, value in named.items():
        if name in pairs:
            a, b = value, named[pairs[name][0]]
            if own and name == "x":
                values += [a / frames.floor_size, b / frames.floor_size]
                continue
            if own and name == "cos yaw":
                values += [b, -a]
                continue
            if not own and name in ("x", "vx"):
                origin = frames.position if name == "x" else frames.velocity
                a, b = a - origin[:, 0].reshape(lead), b - origin[:, 1].reshape(lead)
            values += [cos * a + sin * b, cos * b - sin * a]
            values += [jnp.sqrt(a * a + b * b)] if name == "x" else []
        elif name == "yaw":
            turn = value - jnp.pi / 2 if own else value - frames.heading.reshape(lead)
            values += [jnp.cos(turn), jnp.sin(turn)]
        elif name not in seconds:
            values.append(value)
    return list(zip(_renamed(one, own=own), values, strict=True))


def _headings(columns: list[Column]) -> list[Column]:
    """Renames an agent's own turn to its heading on the floor."""
    names = {"cos turn": "cos heading", "sin turn": "sin heading"}
    return [replace(column, name=names.get(column.name, column.name)) for column in columns]


def _scaled(column: Column, x: jax.Array) -> jax.Array:
    """A column in its scale; what has a unit is cut off, while counts and numbers of teams stay whole."""
    return jnp.clip(x / column.scale, -CLIP, CLIP) if column.unit else x / column.scale


def _in_scales(column: Column) -> Column:
    """Returns the column after division by its scale."""
    unit = f"{column.scale:g} {column.unit}".strip() if column.scale != 1 else column.unit
    return Column(column.name, unit)
