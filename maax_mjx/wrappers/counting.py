"""Objects that pass out of sight, to be counted (Baker et al.'s cognitive transfer task)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.annotated import Count, Positive, check_value
from maax_mjx.common.keys import named_key
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Boxes
from maax_mjx.wrappers.actions import DiscretizeActions
from maax_mjx.wrappers.wrapper import Wrapper


class Passages(struct.PyTreeNode):
    """Where objects go, and when.

    Attributes:
        left: (n_boxes,) bool, whether a box goes to low x; otherwise it goes to high x. (To an agent that looks towards
            low y, low x is on the right.)
        starts: (n_boxes,) int32, env step at which it sets out.
    """

    left: jax.Array
    starts: jax.Array


class ObjectCounting(Wrapper):
    """Moves every box to the left or right end of the floor, and keeps agents where they are.

    Every box goes to one of both sides with even chances, and sets out at a step between 0 and `last_start`. Agents'
    forces do not move them. There is no reward: whoever watches is to know how many went to each side.

    Args:
        env: environment to wrap, with `Boxes` of joints along x; friction would slow them.
        speed: of the boxes, in m/s.
        margin: metres from the edge of the floor to where their middles stop.
        last_start: the last env step at which one sets out.

    Raises:
        ValueError: no boxes, or a number out of its range.
    """

    name = "counting"
    precedes = (DiscretizeActions,)

    def __init__(self, env: Environment, speed: float = 2.0, margin: float = 0.3, last_start: int = 40):
        super().__init__(env)
        self.boxes = self.module_of(Boxes)
        self.speed = float(check_value("speed", speed, Positive))
        self.margin = float(check_value("margin", margin, Positive))
        self.last_start = int(check_value("last_start", last_start, Count))
        self._seconds = self.base.dt

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        state = self.env.begin(key, params)
        side, start = jax.random.split(named_key(key, self.name))
        n = (self.boxes.n_max,)
        starts = jax.random.randint(start, n, 0, self.last_start + 1)
        return self.remember(state, Passages(jax.random.bernoulli(side, 0.5, n), starts))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        data, passages = state.data, state.mechanics[self.name]
        missing = self._targets(state) - data.qpos[self.boxes.qpos_ids[:, 0]]
        going = (state.step >= passages.starts) & state.world.active[self.boxes.kind]
        speed = jnp.where(going, jnp.clip(missing / self._seconds, -self.speed, self.speed), 0.0)
        qvel = data.qvel.at[self.boxes.qvel_ids].set(0.0).at[self.boxes.qvel_ids[:, 0]].set(speed)
        still = action | {"move": jnp.zeros_like(action["move"])}
        return self.env.advance(state.replace(data=data.replace(qvel=qvel)), still)

    def counts(self, state: State) -> jax.Array:
        """Returns how many boxes go to the left and to the right: (2,) int32."""
        left, there = state.mechanics[self.name].left, state.world.active[self.boxes.kind]
        return jnp.stack([(left & there).sum(), (~left & there).sum()]).astype(jnp.int32)

    def arrived(self, state: State) -> jax.Array:
        """Returns whether all boxes are where they go, to a centimetre: () bool."""
        away = jnp.abs(self._targets(state) - state.data.qpos[self.boxes.qpos_ids[:, 0]])
        return ((away < 0.01) | ~state.world.active[self.boxes.kind]).all()

    def _targets(self, state: State) -> jax.Array:
        edge = state.world.plan.floor_size
        return jnp.where(state.mechanics[self.name].left, self.margin, edge - self.margin)
