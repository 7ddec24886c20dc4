"""The rules of capture the flag (named as future work in the thesis)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.checks import check_count, check_positive
from maax_mjx.common.observed import AGENT, POSITION, Column, Observed, flag
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Flags
from maax_mjx.wrappers.contact import AgentAgentContactMask2D
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.rewards import RestrictAgentsRect
from maax_mjx.wrappers.teams import TeamMembership
from maax_mjx.wrappers.wrapper import Wrapper

AT_BASE = -1
"""Carrier of a flag that is at its base."""


class FlagGame(struct.PyTreeNode):
    """The state of the game.

    Attributes:
        carrier: (2,) int32, the agent that carries each team's flag; -1 while the flag is at its base.
        out: (n_agents,) bool, whether an agent was tagged and has not been home since.
        score: (2,) int32, captures of each team.
    """

    carrier: jax.Array
    out: jax.Array
    score: jax.Array


class CaptureTheFlag(Wrapper):
    """Capture the flag: two teams bring the other team's flag home and guard their own.

    The floor has two halves, low y and high y; a team's half is the one with its flag's base. After every env step, in
    this order:

    1. An agent in the other team's half is out when a member of that team who is not out touches it. A flag that it
       carries is back at its base at once.
    2. An agent that is out is in again within `reach` of its own base.
    3. A flag at its base is taken by the nearest opponent within `reach` who is in and carries nothing.
    4. A flag is captured when it is carried to within `reach` of the carrier's own base while its own flag is there:
       the carrier's team scores and gets +1 each, the other team -1 each; the flag is back at its base.

    Agents that are out move freely, but neither tag nor take. A team that has scored `wins_at` times ends the episode.

    Adds the observations `flag_pos` (2, 3), where the flags are now, in metres; `flag_base` (2, 3); `carries` and
    `is_out` (n_agents, 1); `score` (2, 1); `flag_is_own` and `score_is_own` (n_agents, 2, 1), which of the two belong
    to an agent's team; and the metrics `score_<team>` of both, such as `score_reds`.

    Args:
        env: environment to wrap, with `Flags`, one in each half, and teams 0 and 1.
        reach: metres from an agent's centre to a flag or base, seen from above.
        wins_at: captures that end the episode.
        scale: factor of the reward.

    Raises:
        ValueError: no flags, other than two teams, a missing wrapper, or a number out of its range.
    """

    name = "capture_the_flag"
    requires = (TeamMembership, AgentAgentContactMask2D)
    precedes = (PreparationPhase, RestrictAgentsRect)

    def __init__(self, env: Environment, reach: float = 0.4, wins_at: int = 3, scale: float = 1.0):
        super().__init__(env)
        self.reach = check_positive("reach", reach)
        self.wins_at = check_count("wins_at", wins_at, minimum=1)
        self.scale = check_positive("scale", scale)
        if Flags.kind not in self.base.modules:
            raise ValueError("CaptureTheFlag: needs flags; add_module(Flags(...)) to the environment first")
        teams = self.inner(TeamMembership)
        if teams.n_teams != 2:
            raise ValueError(f"CaptureTheFlag: got {teams.n_teams} teams; takes 2")
        self._team = teams.team_index
        self._own = (self._team[:, None] == jnp.arange(2)).astype(jnp.float32)[..., None]

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        nobody = jnp.zeros(self.base.n_agents, bool)
        game = FlagGame(jnp.full(2, AT_BASE, jnp.int32), nobody, jnp.zeros(2, jnp.int32))
        return self._observe(self.remember(self.env.begin(key, params), game))

    def transition(self, state: State, action: Any) -> State:
        before: FlagGame = state.mechanics[self.name]
        state = self.env.advance(state, action)
        game = self._play(state, before)
        captured = (game.score - before.score).astype(state.reward.dtype)
        gained = (captured[self._team] - captured[1 - self._team]) * self.playing(state)
        state = state.replace(
            reward=state.reward + self.scale * gained,
            terminated=state.terminated | (game.score >= self.wins_at).any(),
        )
        return self._observe(self.remember(state, game))

    def _play(self, state: State, game: FlagGame) -> FlagGame:
        team, other = self._team, 1 - self._team
        playing = self.playing(state)
        xy, base = self._positions(state)[:, :2], state.world.sites[Flags.kind][:, :2]
        there = state.world.active[Flags.kind]
        half = state.world.plan.floor_size / 2
        at_home = (xy[:, 1] < half) == (base[team, 1] < half)

        tagging = state.mechanics[AgentAgentContactMask2D.name] & ~game.out & (team != team[:, None])
        out = game.out | (tagging.any(axis=1) & ~at_home & playing)
        fallen = (game.carrier >= 0) & out[game.carrier]
        carrier = jnp.where(fallen, AT_BASE, game.carrier)
        near_own = jnp.linalg.norm(xy - base[team], axis=1) <= self.reach
        out &= ~near_own

        away = jnp.linalg.norm(xy - base[other], axis=1)
        can_take = playing & ~out & (away <= self.reach)
        of_flag = can_take & (other == jnp.arange(2)[:, None])  # (2, n_agents): which agents can take which flag
        nearest = jnp.where(of_flag, away, jnp.inf).argmin(axis=1).astype(jnp.int32)
        taken = of_flag.any(axis=1) & (carrier == AT_BASE) & there
        carrier = jnp.where(taken, nearest, carrier)

        own_there = carrier[::-1] == AT_BASE
        home = (carrier >= 0) & near_own[carrier] & own_there & there[::-1]
        score = game.score + home[::-1]
        return FlagGame(jnp.where(home, AT_BASE, carrier), out, score)

    def _positions(self, state: State) -> jax.Array:
        return state.data.xpos[self.base.agents.body_ids]

    def _observe(self, state: State) -> State:
        game: FlagGame = state.mechanics[self.name]
        base = state.world.sites[Flags.kind]
        carried = self._positions(state)[game.carrier]
        carries = (jnp.arange(self.base.n_agents)[:, None] == game.carrier).any(axis=1)
        obs = {
            "flag_pos": jnp.where((game.carrier >= 0)[:, None], carried, base),
            "flag_base": base,
            "carries": carries[:, None].astype(jnp.float32),
            "is_out": game.out[:, None].astype(jnp.float32),
            "score": game.score[:, None].astype(jnp.float32),
            "flag_is_own": self._own,
            "score_is_own": self._own,
        }
        scores = {f"score_{team}": game.score[i] for i, team in enumerate(self.teams)}
        return state.replace(obs=state.obs | obs, metrics=state.metrics | scores)

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | {
            "flag_pos": Observed((Flags.kind,), POSITION),
            "flag_base": Observed((Flags.kind,), POSITION),
            "carries": Observed((AGENT,), flag("carries"), private=False),
            "is_out": Observed((AGENT,), flag("is out"), private=False),
            "score": Observed(("team",), (Column("score"),)),
            "flag_is_own": Observed((AGENT, Flags.kind), flag("is own")),
            "score_is_own": Observed((AGENT, "team"), flag("is own")),
        }
