"""The state of an environment: one flat pytree."""

from __future__ import annotations

from typing import Any

import jax
from flax import struct

from maax_mjx.common.params import DomainParams
from maax_mjx.layout import World
from maax_mjx.physics import Data


class State(struct.PyTreeNode):
    """Everything about one world at one time.

    Attributes:
        data: the physics.
        world: in what this world differs from the compiled model, and its room plan.
        params: the ranges that it was drawn from; in a batch whose ranges were changed, that the next will be.
        obs: observations by name.
        reward: (n_agents,) of the step that led here.
        terminated: () bool, the episode ended by the game's rules.
        truncated: () bool, it was cut off: the horizon, or a physics fault.
        step: () int32, env steps since reset.
        key: this world's random key.
        metrics: of this step: "physics_fault", "layout_invalid", "contact_overflow", each () bool, and the wrappers'.
        mechanics: each wrapper's own struct, by its name.
    """

    data: Data
    world: World
    params: DomainParams
    obs: dict[str, jax.Array]
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    step: jax.Array
    key: jax.Array
    metrics: dict[str, jax.Array]
    mechanics: dict[str, Any]

    @property
    def done(self) -> jax.Array:
        """() bool, terminated or truncated."""
        return self.terminated | self.truncated


FIELDS = tuple(State.__dataclass_fields__)


def plain(state: State) -> State:
    """What an environment itself knows, without what a subclass adds for a batch."""
    return State(**{name: getattr(state, name) for name in FIELDS})
