"""Rewards of hide and seek, and of staying within a rectangle."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from maax_mjx.common.checks import check_bool, check_choice, check_positive
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.worldgen.checks import check_vector
from maax_mjx.wrappers.contact import AgentAgentContactMask2D
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.senses import LineOfSight
from maax_mjx.wrappers.teams import HIDERS, SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import RewardWrapper

REW_TYPES = ("selfish", "team_mean", "team_zero_sum")
CATCHES = ("contact", "vision")
"""What catches a hider."""


class RestrictAgentsRect(RewardWrapper):
    """Gives agents outside a rectangle a penalty instead of their reward (OpenAI's RestrictAgentsRect).

    Args:
        env: environment to wrap.
        rect: x0, y0, x1, y1 in metres; it may be larger than the floor, but must overlap it.
        penalty: the amount, a positive number.
        penalize_objects_out: whether every agent gets the penalty while a box or a ramp is outside.

    Raises:
        ValueError: a rectangle that is empty or beside the floor, or a penalty that is not positive.
    """

    name = "restrict_agents_rect"
    precedes = (PreparationPhase,)

    def __init__(
        self,
        env: Environment,
        rect: Sequence[float],
        penalty: float = 10.0,
        penalize_objects_out: bool = False,
    ):
        super().__init__(env)
        corners = check_vector("rect", rect, 4, takes := "x0, y0, x1, y1 in metres with x0 < x1 and y0 < y1")
        if not (corners[:2] < corners[2:]).all():
            raise ValueError(f"rect: got {rect!r}; takes {takes}")
        floor = self.base.floor_size
        if (corners[:2] >= floor).any() or (corners[2:] <= 0).any():
            raise ValueError(f"rect: got {rect!r}; takes one that overlaps the floor, 0 to {floor:g} metres")
        self.rect, self.penalty = corners, check_positive("penalty", penalty)
        self.penalize_objects_out = check_bool("penalize_objects_out", penalize_objects_out)

    def reward(self, state: State) -> jax.Array:
        penalised = self._outside(state, self.base.agents)
        if self.penalize_objects_out:
            objects = [m for m in self.base.movables if m is not self.base.agents]
            out = jnp.stack([self._outside(state, module).any() for module in objects]).any() if objects else False
            penalised = penalised | (out & self.playing(state))
        return jnp.where(penalised, -self.penalty, state.reward)

    def _outside(self, state: State, module: Entities) -> jax.Array:
        xy = state.data.qpos[module.qpos_ids[:, :2]]
        out = ((xy < self.rect[:2]) | (xy > self.rect[2:])).any(axis=1)
        return out & state.world.active[module.kind]


class HideAndSeekReward(RewardWrapper):
    """Adds +1 for hiders that are not caught, else -1, and +1 for seekers that catch a hider, else -1.

    The rule is that of Baker et al. (by vision: a seeker catches the hiders it sees) and of the thesis (5.2.2; by
    contact: those it touches). Absent agents neither get nor cause a reward. Hiders are team 0 of `TeamMembership`,
    seekers team 1.

    Args:
        env: environment to wrap.
        rew_type: "selfish" (each its own), "team_mean" (the mean of its team), "team_zero_sum" (hiders the least of
            their team, seekers the most, so that one caught hider loses for all).
        by: "contact" or "vision".
        scale: factor of the reward.

    Raises:
        ValueError: an unknown type or `by`, a scale that is not positive, a single team that is neither hiders nor
            seekers, or a missing wrapper.
    """

    name = "hide_and_seek_reward"
    requires = (TeamMembership,)
    precedes = (PreparationPhase, RestrictAgentsRect)

    def __init__(self, env: Environment, rew_type: str = "selfish", by: str = "contact", scale: float = 1.0):
        super().__init__(env)
        self.rew_type = check_choice("rew_type", rew_type, REW_TYPES)
        self.scale = check_positive("scale", scale)
        self.by = check_choice("by", by, CATCHES)
        self.inner(AgentAgentContactMask2D if by == "contact" else LineOfSight)
        teams = self.inner(TeamMembership)
        # A game may have hiders alone, or seekers.
        if len(env.teams) < 2 and not {HIDERS, SEEKERS} & set(env.teams):
            raise ValueError(f"HideAndSeekReward: env has the team {[*env.teams]}; takes two, hiders and seekers")
        self._hiders, self._seekers = teams.of(HIDERS), teams.of(SEEKERS)

    def reward(self, state: State) -> jax.Array:
        active = self.playing(state)
        hiders, seekers = active & self._hiders, active & self._seekers
        has = self._mask(state) & seekers[:, None] & hiders
        hidden = jnp.where(has.any(axis=0), -1.0, 1.0)
        found = jnp.where(has.any(axis=1), 1.0, -1.0)
        if self.rew_type == "team_mean":
            hidden, found = _mean(hidden, hiders), _mean(found, seekers)
        elif self.rew_type == "team_zero_sum":
            hidden = jnp.where(hiders, hidden, 1.0).min()
            found = jnp.where(seekers, found, -1.0).max()
        own = jnp.where(hiders, hidden, 0.0) + jnp.where(seekers, found, 0.0)
        return state.reward + self.scale * own

    def caught(self, state: State) -> jax.Array:
        """Whether any seeker catches any hider: () bool."""
        active = self.playing(state)
        return (self._mask(state) & (active & self._seekers)[:, None] & (active & self._hiders)).any()

    def _mask(self, state: State) -> jax.Array:
        """Returns (n_agents, n_agents) bool: which agents catch which."""
        if self.by == "contact":
            return state.mechanics[AgentAgentContactMask2D.name]
        return state.mechanics[LineOfSight.name]["sees_agent"]


def _mean(values: jax.Array, of: jax.Array) -> jax.Array:
    return jnp.where(of, values, 0.0).sum() / jnp.maximum(of.sum(), 1)
