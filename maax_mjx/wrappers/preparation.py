"""The time in which hiders prepare."""

from __future__ import annotations

from math import ceil
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.env import Environment
from maax_mjx.params import DomainParams
from maax_mjx.state import State
from maax_mjx.wrappers.actions import DiscretizeActions
from maax_mjx.wrappers.teams import SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import Wrapper


class PreparationPhase(Wrapper):
    """For the first `ceil(prep_fraction * horizon)` steps seekers cannot act and nobody is rewarded (thesis 5.2.1).

    All actions of the seekers are nulled: movement and every other, whose first axis is the agents'. Adds
    `prep_remaining` (n_agents, 1): the share of the phase that is left, from 1 down to 0.

    Args:
        env: what to wrap.
        prep_fraction: share of the episode, in [0, 1].

    Attributes:
        n_steps: how many steps the phase has.

    Raises:
        ValueError: a fraction outside [0, 1].
    """

    name = "preparation"
    requires = (TeamMembership,)
    precedes = (DiscretizeActions,)

    def __init__(self, env: Environment, prep_fraction: float = 0.4):
        super().__init__(env)
        if isinstance(prep_fraction, bool) or not isinstance(prep_fraction, int | float) or not 0 <= prep_fraction <= 1:
            raise ValueError(f"prep_fraction: got {prep_fraction!r}; takes a number in [0, 1]")
        self.n_steps = ceil(round(prep_fraction * env.base.horizon, 9))
        self._seekers = self.inner(TeamMembership).of(SEEKERS)

    def reset(self, key: jax.Array, params: DomainParams | None = None) -> State:
        return self._observed(self.env.reset(key, params))

    def step(self, state: State, action: dict[str, Any]) -> State:
        preparing = state.step < self.n_steps
        nulled = {name: self._null(jnp.asarray(part), preparing) for name, part in action.items()}
        state = self.env.step(state, nulled)
        return self._observed(state.replace(reward=jnp.where(preparing, 0.0, state.reward)))

    def _null(self, part: jax.Array, preparing: jax.Array) -> jax.Array:
        seekers = np.reshape(self._seekers, (-1, *[1] * (part.ndim - 1)))
        return jnp.where(preparing & seekers, jnp.zeros_like(part), part)

    def _observed(self, state: State) -> State:
        left = jnp.maximum(1 - state.step / max(self.n_steps, 1), 0.0) if self.n_steps else jnp.zeros(())
        remaining = jnp.full((self.base.n_agents, 1), left, jnp.float32)
        return state.replace(obs=state.obs | {"prep_remaining": remaining})
