"""Observations in the agents' own frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

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
    sin, and its velocity in its own frame. Every column is divided by its scale; those with a unit are clipped at 5.
    Adds `time_left` (n_agents, 1), which is always 1 in an endless game. Entities that are not in play are zero; masks
    stay as they are.

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
            own = self._is_own(name)
            view = _View(dict(zip(one.names(), jnp.moveaxis(obs[name], -1, 0), strict=True)), frames, own)
            scaled = [_scaled(column, value(view)) for column, value in _parts(one, own=own)]
            x = shown(jnp.stack(scaled, axis=-1).astype(jnp.float32), playing)
            obs[name] = x if one.present is None else shown(x, state.obs[one.present] > 0)
        return obs | {"time_left": time_left(state, self.base.horizon, self.base.n_agents)}

    def declared(self) -> dict[str, Observed]:
        table = self.env.declared()
        for name, one in self._table.items():
            if one.columns:
                table[name] = replace(
                    table[name], columns=tuple(_in_scales(c) for c, _ in _parts(one, own=self._is_own(name)))
                )
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


class _View(NamedTuple):
    """An array's columns by name, (n_agents, ...) each, and the frames that its agents see them in."""

    columns: dict[str, jax.Array]
    frames: Frames
    own: bool

    def kept(self, name: str) -> jax.Array:
        return self.columns[name]

    def minus(self, name: str) -> jax.Array:
        return -self.columns[name]

    def share_of_floor(self, name: str) -> jax.Array:
        return self.columns[name] / self.frames.floor_size

    def ahead(self, x: str, y: str) -> jax.Array:
        a, b = self._relative(x, y)
        return jnp.cos(self._heading(a)) * a + jnp.sin(self._heading(a)) * b

    def left(self, x: str, y: str) -> jax.Array:
        a, b = self._relative(x, y)
        return jnp.cos(self._heading(a)) * b - jnp.sin(self._heading(a)) * a

    def distance(self, x: str, y: str) -> jax.Array:
        a, b = self._relative(x, y)
        return jnp.sqrt(a * a + b * b)

    def turn(self, yaw: str) -> jax.Array:
        value = self.columns[yaw]
        # At yaw 0 agents face -y.
        return value - (jnp.pi / 2 if self.own else self._heading(value))

    def _relative(self, x: str, y: str) -> tuple[jax.Array, jax.Array]:
        a, b = self.columns[x], self.columns[y]
        if self.own or x not in ("x", "vx"):
            return a, b
        origin = self.frames.position if x == "x" else self.frames.velocity
        return a - _like(origin[:, 0], a), b - _like(origin[:, 1], b)

    def _heading(self, x: jax.Array) -> jax.Array:
        return _like(self.frames.heading, x)


Parts = list[tuple[Column, Callable[[_View], jax.Array]]]


def _parts(one: Observed, *, own: bool) -> Parts:
    """Returns what an array's columns become, before scaling: the new columns, and where their numbers come from."""
    names = one.names()
    pairs = {first: pair for first, pair in FLAT.items() if first in names and pair[0] in names}
    seconds = {pair[0] for pair in pairs.values()}
    cos, sin = flag("cos heading", "sin heading") if own else flag("cos turn", "sin turn")
    parts: Parts = []
    for column in one.columns:
        name = column.name
        if name in pairs:
            second, ahead, left = pairs[name]
            of: Any = {"x": name, "y": second}
            if own and name == "x":
                parts += [(Column(f"floor {n}"), partial(_View.share_of_floor, name=old)) for n, old in of.items()]
            elif own and name == "cos yaw":
                # At yaw 0 agents face -y: their heading is yaw - pi / 2.
                parts.append((cos, partial(_View.kept, name=second)))
                parts.append((sin, partial(_View.minus, name=name)))
            else:
                parts.append((replace(column, name=ahead), partial(_View.ahead, **of)))
                parts.append((replace(column, name=left), partial(_View.left, **of)))
                parts += [(DISTANCE, partial(_View.distance, **of))] if name == "x" else []
        elif name == "yaw":
            parts.append((cos, lambda view: jnp.cos(view.turn("yaw"))))
            parts.append((sin, lambda view: jnp.sin(view.turn("yaw"))))
        elif name not in seconds:
            parts.append((column, partial(_View.kept, name=name)))
    return parts


def _like(x: jax.Array, other: jax.Array) -> jax.Array:
    """Returns numbers (n_agents,) with as many axes as the other array, to be broadcast over them."""
    return x.reshape(-1, *[1] * (other.ndim - 1))


def _scaled(column: Column, x: jax.Array) -> jax.Array:
    """A column in its scale; what has a unit is cut off, while counts and numbers of teams stay whole."""
    return jnp.clip(x / column.scale, -CLIP, CLIP) if column.unit else x / column.scale


def _in_scales(column: Column) -> Column:
    """Returns the column after division by its scale."""
    unit = f"{column.scale:g} {column.unit}".strip() if column.scale != 1 else column.unit
    return Column(column.name, unit)
