"""The state of an environment: one flat pytree."""

from __future__ import annotations

from typing import Any

import jax
from flax import struct

from maax_mjx.common.params import DomainParams
from maax_mjx.layout import World
from maax_mjx.physics import Data


class State(struct.PyTreeNode):
    """The complete state of one world at one time.

    Attributes:
        data: the physics state.
        world: the model fields in which this world differs from the compiled model, and its room plan.
        params: the ranges it was drawn from; after a batch's ranges were changed, those of its next episode.
        obs: observations by name.
        reward: (n_agents,) reward of the step that led here.
        terminated: () bool, whether the episode ended by the game's rules.
        truncated: () bool, whether it was cut off by the horizon or a physics fault.
        step: () int32, env steps since reset.
        key: the world's random key.
        metrics: numbers of this step: "physics_fault", "layout_invalid", "contact_overflow", each () bool,
            and the wrappers'.
        mechanics: each wrapper's own struct, by the wrapper's name.
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
        """Whether the episode is terminated or truncated: () bool."""
        return self.terminated | self.truncated


FIELDS = tuple(State.__dataclass_fields__)


def plain(state: State) -> State:
    """Returns the state without the fields that a subclass adds for a batch."""
    return State(**{name: getattr(state, name) for name in FIELDS})
