"""Grabbing and carrying objects."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from gymnasium import spaces

from maax_mjx.common.checks import check_bool, check_positive
from maax_mjx.common.observed import Observed, flag
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.grabs.rules import NOTHING, grab_rule
from maax_mjx.wrappers.grabs.slots import GrabSlots
from maax_mjx.wrappers.handled import by_kind, declared_by_kind
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.reach import Reach
from maax_mjx.wrappers.wrapper import Wrapper

GRAB, PULL, COLUMNS = "grab", "pull", flag("you_pull", "obj_pull")


class Grabs(struct.PyTreeNode):
    """The current holds.

    Attributes:
        held: (n_agents,) int32, index of the held object among the grabbable ones; -1 for nothing.
        relative: (n_agents, 8) its pose in the agent's frame when it was grabbed: position, quaternion, yaw.
    """

    held: jax.Array
    relative: jax.Array


class GrabObjects(Wrapper):
    """Lets agents hold objects within reach, which then move and turn with them (Baker et al.).

    While an agent grabs, it holds the nearest object in reach, in the relative pose at which it was grabbed. Locked
    objects can be held, too. Adds `action["grab"]` (n_agents,), or (n_agents, n_grabbable) with `selective`; and for
    every kind of object the observation `<kind>_pull` (n_agents, n, 2): held by oneself, held by anybody.

    Args:
        env: environment to wrap; a copy of it gets the constraints of the holds.
        objects: names of the modules whose objects can be grabbed: "box", "ramp", "cylinder", or your own; None is
            boxes and ramps, if there are any.
        radius: metres from an agent's centre to the object's surface, as an oriented box.
        exclusive: whether only one agent, the nearest, can hold an object.
        selective: whether agents choose objects by index; otherwise they take the nearest.
        soft: whether a hold is a weld with MuJoCo's default softness, as in the published code: what is held stays
            within 23 mm of its place (median), instead of 7 mm.
        in_vision_only: whether an agent can only hold what it saw after the previous step; needs `LineOfSight`.

    Raises:
        ValueError: an unknown module, a radius that is not positive, or vision without `LineOfSight`.
    """

    name = "grabs"
    precedes = (PreparationPhase,)

    def __init__(
        self,
        env: Environment,
        objects: Sequence[str] | None = None,
        radius: float = 0.25,
        exclusive: bool = False,
        selective: bool = False,
        in_vision_only: bool = False,
        soft: bool = False,
    ):
        super().__init__(deepcopy(check_environment(env)))
        self._reach = Reach(self, objects, check_positive("radius", radius), in_vision_only)
        self.exclusive = check_bool("exclusive", exclusive)
        self.selective = check_bool("selective", selective)
        self.modules, self.n_grabbable = self._reach.modules, self._reach.n
        self._slots = GrabSlots(self.base.agents, self._reach.modules, check_bool("soft", soft))
        self.base.attach(self._slots)

    @property
    def action_space(self) -> spaces.Dict:
        n = self.base.n_agents
        shape = (n, self.n_grabbable) if self.selective else (n,)
        return spaces.Dict({**self.env.action_space.spaces, GRAB: spaces.MultiBinary(shape)})

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        mine = {GRAB: tuple((m.kind, m.n_max) for m in self.modules)} if self.selective else {}
        return self.env.acts_on | mine

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        n = self.base.n_agents
        grabs = Grabs(jnp.full(n, NOTHING, jnp.int32), jnp.zeros((n, 8)))
        return self._observe(self.remember(self.env.begin(key, params), grabs))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        wants = jnp.asarray(action[GRAB]) > 0
        wants = wants if self.selective else wants[:, None]
        old: Grabs = state.mechanics[self.name]
        distance, near = self._reach(state)
        held = grab_rule(wants & near, distance, self.exclusive)
        # The pose is taken when a hold begins, and kept while it lasts.
        same = (held == old.held)[:, None]
        grabs = Grabs(held, jnp.where(same, old.relative, self._slots.relative(state.data, held)))
        state = self.remember(state, grabs)
        state = self._slots.hold(state, held, grabs.relative, self.base.overlay)
        return self._observe(self.env.advance(state, {k: part for k, part in action.items() if k != GRAB}))

    def _observe(self, state: State) -> State:
        grabs: Grabs = state.mechanics[self.name]
        mine = grabs.held[:, None] == jnp.arange(self.n_grabbable)
        columns = [mine, jnp.broadcast_to(mine.any(axis=0), mine.shape)]
        return state.replace(obs=state.obs | by_kind(self.modules, columns, PULL))

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | declared_by_kind(self.modules, PULL, COLUMNS)
