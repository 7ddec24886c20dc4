"""Masks of actions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from maax_mjx.common.arrays import null_rows, shown
from maax_mjx.common.checks import check_choice
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.actions import DiscretizeActions
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.senses import LineOfSight
from maax_mjx.wrappers.teams import HIDERS, SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import ActionWrapper

Mask = Callable[[State], jax.Array]


class MaskActions(ActionWrapper):
    """Zeroes the parts of one action that a mask does not allow (OpenAI's MaskActionWrapper).

    Args:
        env: environment to wrap.
        action: name of the action.
        mask: a function from the state before the step to (n_agents,) or (n_agents, k) bool, matching the action's
            shape; or names of masks that `LineOfSight` found after the previous step, such as
            `("sees_box", "sees_ramp")`, joined along the last axis.

    Raises:
        ValueError: an unknown action or name, or a mask of another shape than the action's.
    """

    precedes = (DiscretizeActions,)

    def __init__(self, env: Environment, action: str, mask: Mask | Sequence[str]):
        super().__init__(env)
        self.masked = check_choice("action", action, env.action_space.spaces)
        self._mask: Mask | None = mask if callable(mask) else None
        self._names = () if callable(mask) else self._checked(mask)
        shape = env.action_space[action].shape or ()
        got = jax.eval_shape(lambda key: self.allowed(env.reset(key)), jax.random.key(0)).shape
        if got not in (shape[:1], shape):
            raise ValueError(f"mask: has shape {got}; takes {shape[:1]} or {shape}, as action {action!r}")

    def allowed(self, state: State) -> jax.Array:
        """Returns which parts of the action are allowed: (n_agents,) or (n_agents, k) bool."""
        return self.inner(LineOfSight).seen(state, self._names) if self._mask is None else self._mask(state)

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        return {**action, self.masked: shown(jnp.asarray(action[self.masked]), self.allowed(state))}

    def _checked(self, names: Sequence[str]) -> tuple[str, ...]:
        senses = self.inner(LineOfSight).senses
        if isinstance(names, str):
            raise ValueError(f"mask: got {names!r}; takes a function, or a list of names of {list(senses)}")
        return tuple(check_choice("mask", name, senses) for name in names)


class MaskPreparationAction(ActionWrapper):
    """Zeroes one action of all agents in the preparation phase (OpenAI's MaskPrepPhaseAction).

    Args:
        env: environment to wrap.
        action: name of the action.

    Raises:
        ValueError: an unknown action, or a missing wrapper.
    """

    requires = (PreparationPhase,)
    precedes = (DiscretizeActions,)

    def __init__(self, env: Environment, action: str):
        super().__init__(env)
        self.masked = check_choice("action", action, env.action_space.spaces)
        self._n_steps = self.inner(PreparationPhase).n_steps

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        part = jnp.asarray(action[self.masked])
        return {**action, self.masked: jnp.where(state.step < self._n_steps, jnp.zeros_like(part), part)}


class MaskUnseenAction(ActionWrapper):
    """Zeroes one action of a team while any seeker saw any hider after the previous step (OpenAI's MaskUnseenAction).

    Args:
        env: environment to wrap.
        action: name of the action.
        team: number of the team, as in `TeamMembership`.

    Raises:
        ValueError: an unknown action or team, or a missing wrapper.
    """

    requires = (TeamMembership, LineOfSight)
    precedes = (DiscretizeActions,)

    def __init__(self, env: Environment, action: str, team: int | str = HIDERS):
        super().__init__(env)
        self.masked = check_choice("action", action, env.action_space.spaces)
        teams = self.inner(TeamMembership)
        if not teams.of(team).any():
            raise ValueError(f"team: got {team!r}; takes one of {list(teams.teams)}, or its number")
        self._team, self._hiders, self._seekers = teams.of(team), teams.of(HIDERS), teams.of(SEEKERS)

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        sees = state.mechanics[LineOfSight.name]["sees_agent"]
        seen = (sees & self._seekers[:, None] & self._hiders).any()
        part = {self.masked: jnp.asarray(action[self.masked])}
        return {**action, **null_rows(part, seen & self._team)}
