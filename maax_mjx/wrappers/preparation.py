"""The phase in which hiders prepare."""

from __future__ import annotations

from math import ceil
from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.common.annotated import Fraction, check_value
from maax_mjx.common.arrays import null_rows
from maax_mjx.common.checks import check_bool
from maax_mjx.common.observed import AGENT, Observed, flag
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.actions import DiscretizeActions
from maax_mjx.wrappers.teams import SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import Wrapper


class PreparationPhase(Wrapper):
    """Stops seekers and rewards for the first `ceil(prep_fraction * horizon)` steps (thesis 5.2.1).

    All actions of the seekers are zeroed: movement and every other action, whose first axis is the agents'; in
    `state.can_act` they are False. Adds the observation `prep_remaining` (n_agents, 1): share of the phase that is
    left, from 1 down to 0.

    Args:
        env: environment to wrap.
        prep_fraction: share of the episode, in [0, 1]; 0 in an endless game.
        blind: whether seekers are also blind in the phase: their `LineOfSight` and `Lidar` observations are zero.

    Attributes:
        n_steps: number of steps in the phase.
        seekers: (n_agents,) bool, which agents wait in it.

    Raises:
        ValueError: a fraction outside [0, 1], or other than 0 of a game without a horizon; `blind` without a sense
            inside, or whose observations were changed.
    """

    name = "preparation"
    requires = (TeamMembership,)
    precedes = (DiscretizeActions,)

    def __init__(self, env: Environment, prep_fraction: float = 0.4, blind: bool = False):
        super().__init__(env)
        check_value("prep_fraction", prep_fraction, Fraction)
        horizon = env.base.horizon
        if horizon is None and prep_fraction:
            raise ValueError(
                f"prep_fraction: got {prep_fraction} with horizon=None; takes 0 there, as an endless game has no shares"
            )
        self.n_steps = ceil(round(prep_fraction * (horizon or 0), 9))
        self.seekers = self.inner(TeamMembership).of(SEEKERS)
        self._senses = [layer for layer in self.env.layers if layer.senses] if check_bool("blind", blind) else []
        if blind:
            self._check_senses()

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        return self._observe(self.env.begin(key, params))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        preparing = state.step < self.n_steps
        arrays = {name: jnp.asarray(part) for name, part in action.items()}
        nulled = null_rows(arrays, preparing & self.seekers)
        state = self.env.advance(state, nulled)
        return self._observe(state.replace(reward=jnp.where(preparing, 0.0, state.reward)))

    def _check_senses(self) -> None:
        if not self._senses:
            raise ValueError("blind: got True without a sense inside; takes LineOfSight or Lidar inside")
        shapes = {name: space.shape or () for name, space in self.env.observation_space.spaces.items()}
        for sense in self._senses:
            sense.check_senses(shapes)

    def _observe(self, state: State) -> State:
        left = jnp.maximum(1 - state.step / max(self.n_steps, 1), 0.0) if self.n_steps else jnp.zeros(())
        remaining = jnp.full((self.base.n_agents, 1), left, jnp.float32)
        waiting = (state.step < self.n_steps) & self.seekers
        for sense in self._senses:
            state = sense.blind(state, waiting)
        return state.replace(obs=state.obs | {"prep_remaining": remaining}, can_act=state.can_act & ~waiting)

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | {"prep_remaining": Observed((AGENT,), flag("preparation left"))}
