"""Statistics of an episode."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.common.arrays import running_mean
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.wrappers.contact import AgentAgentContactMask2D
from maax_mjx.wrappers.food import EatFood
from maax_mjx.wrappers.locks.wrapper import LockObjects
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.rewards import HideAndSeekReward
from maax_mjx.wrappers.teams import HIDERS, SEEKERS, TeamMembership
from maax_mjx.wrappers.wrapper import StateWrapper, find, find_all


class Stats(struct.PyTreeNode):
    """The memory from which statistics are computed.

    Attributes:
        start: (n, 2) metres, initial positions of all movable things.
        before: (n, 2) metres, their positions after the previous step.
        touching: (n_agents, n_agents) bool, which agents touched after the previous step.
        played: () int32, steps after preparation so far; fewer than `state.step` says in an episode that began later.
        totals: metrics that accumulate over the episode, by name.
    """

    start: jax.Array
    before: jax.Array
    touching: jax.Array
    played: jax.Array
    totals: dict[str, jax.Array]


class TrackStats(StateWrapper):
    """Adds statistics of the episode so far to `state.metrics` (OpenAI's TrackStatWrapper, and more).

    - `max_box_move`, `max_ramp_move`, ...: metres from its start of the box, ramp, ... that moved furthest.
    - `boxes_locked`, `ramps_locked`, ...: number of locked ones; with `LockObjects` inside.
    - `food_eaten`: units of food that all agents ate; with `EatFood` inside.
    - `distance_run` (n_agents,): metres that every agent has travelled.
    - `catches`: times that a seeker began to touch a hider after preparation; with `AgentAgentContactMask2D` and
      `TeamMembership` inside.
    - `caught`: share of the steps after preparation in which a hider was caught by the game's rule, by touch or by
      sight; with `HideAndSeekReward` inside.

    With `PreparationPhase` inside, the statistics of objects and food are also there as `<name>_prep`, at their values
    after the phase's last step, and zero before; also in an episode that began after it, by `reset(stagger=True)`.

    Args:
        env: environment to wrap.
    """

    name = "stats"
    follows = (AgentAgentContactMask2D, EatFood, HideAndSeekReward, LockObjects, PreparationPhase, TeamMembership)

    def __init__(self, env: Environment):
        super().__init__(env)
        self._modules = self.base.movables
        self._locks = find_all(env, LockObjects)
        preparation = find(env, PreparationPhase)
        self._prep_steps = None if preparation is None else preparation.n_steps
        self._rule = find(env, HideAndSeekReward)
        self._food = find(env, EatFood)
        teams = find(env, TeamMembership)
        self._catches = teams is not None and find(env, AgentAgentContactMask2D) is not None
        if teams is not None:
            self._pairs = teams.of(SEEKERS)[:, None] & teams.of(HIDERS)

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        state = self.env.begin(key, params)
        here = self._positions(state)
        n = self.base.n_agents
        totals = {"distance_run": jnp.zeros(n)}
        if self._catches:
            totals["catches"] = jnp.zeros((), jnp.int32)
        if self._rule is not None:
            totals["caught"] = jnp.zeros(())
        things = self._things(state, here, here)
        if self._prep_steps is not None:
            totals |= {f"{name}_prep": jnp.zeros_like(value) for name, value in things.items()}
        return self._noted(state, Stats(here, here, self._touching(state), jnp.zeros((), jnp.int32), totals), things)

    def observe(self, state: State) -> State:
        stats: Stats = state.mechanics[self.name]
        here, touching = self._positions(state), self._touching(state)
        totals = dict(stats.totals)
        way = jnp.linalg.norm(here - stats.before, axis=1)[self._rows(self.base.agents)]
        totals["distance_run"] += jnp.where(self.playing(state), way, 0.0)
        playing = state.step > (self._prep_steps or 0)
        played = stats.played + playing
        if self._rule is not None:
            totals["caught"] = running_mean(totals["caught"], self._rule.caught(state), playing, played)
        if self._catches:
            new = (touching & ~stats.touching & self._pairs).sum()
            totals["catches"] += jnp.where(playing, new, 0).astype(jnp.int32)
        things = self._things(state, stats.start, here)
        if self._prep_steps is not None:
            for name, value in things.items():
                at_end = state.step == self._prep_steps
                totals[f"{name}_prep"] = jnp.where(at_end, value, totals[f"{name}_prep"])
        return self._noted(state, stats.replace(before=here, touching=touching, played=played, totals=totals), things)

    def _noted(self, state: State, stats: Stats, things: dict[str, jax.Array]) -> State:
        return self.remember(state, stats).replace(metrics=state.metrics | stats.totals | things)

    def _things(self, state: State, start: jax.Array, here: jax.Array) -> dict[str, jax.Array]:
        """Returns how far objects are from their starts, how many are locked, and how much food was eaten."""
        numbers: dict[str, jax.Array] = {}
        away = jnp.linalg.norm(here - start, axis=1)
        for module in self._modules:
            if module is not self.base.agents:
                moved = jnp.where(state.world.active[module.kind], away[self._rows(module)], 0.0)
                numbers[f"max_{module.kind}_move"] = moved.max()
        for layer in self._locks:
            parts = np.cumsum([m.n_max for m in layer.modules])[:-1]
            locked = jnp.split(state.mechanics[layer.name].locked, parts)
            for module, part in zip(layer.modules, locked, strict=True):
                numbers[f"{module.plural}_locked"] = part.sum().astype(jnp.int32)
        if self._food is not None:
            numbers["food_eaten"] = state.mechanics[self._food.name].eaten.sum()
        return numbers

    def _positions(self, state: State) -> jax.Array:
        return jnp.concatenate([state.data.qpos[m.qpos_ids[:, :2]] for m in self._modules])

    def _rows(self, module: Entities) -> slice:
        first = sum(m.n_max for m in self._modules[: self._modules.index(module)])
        return slice(first, first + module.n_max)

    def _touching(self, state: State) -> jax.Array:
        n = self.base.n_agents
        return state.mechanics[AgentAgentContactMask2D.name] if self._catches else jnp.zeros((n, n), bool)
