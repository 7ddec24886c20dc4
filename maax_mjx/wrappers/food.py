"""Eating food (Baker et al.'s games with food)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnasium import spaces

from maax_mjx.common.annotated import NonNegativeRange, Positive, PositiveCount, check_value
from maax_mjx.common.checks import check_bool, check_choice, pair_of
from maax_mjx.common.keys import named_key
from maax_mjx.common.observed import Column, Observed
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Food
from maax_mjx.wrappers.handled import check_new_action
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.senses import BETWEEN
from maax_mjx.wrappers.teams import TeamMembership
from maax_mjx.wrappers.wrapper import ActionWrapper, Wrapper

EAT = "eat"
FOOD_REW_TYPES = ("selfish", "team_mean")


class Meals(struct.PyTreeNode):
    """The food of a world.

    Attributes:
        health: (n_food,) units that are left.
        empty: (n_food,) int32, steps since nothing was left.
        eaten: (n_agents,) units that every agent ate in this episode.
        scale: () reward for a unit.
    """

    health: jax.Array
    empty: jax.Array
    eaten: jax.Array
    scale: jax.Array


class EatFood(Wrapper):
    """Lets agents eat food that is near, a unit of each piece at every step, for a reward, by the published code.

    After the step, an agent eats from every piece that it asks for, that is nearer than `radius` and has something
    left. Where several ask for more than is left, they share it evenly. Adds `action["eat"]` (n_agents, n_food) of 0
    and 1, and the observation `food_health` (n_food, 1): units that are left.

    Who may eat what and when is said by wrappers around it: `MaskActions(env, "eat", ["sees_food"])`,
    `MaskPreparationAction`, `MaskUnseenAction`, `AlwaysEat`. The reward is given in the preparation phase, too, but for
    seekers, who cannot act then.

    Args:
        env: environment to wrap, with `Food`.
        radius: metres from an agent to the middle of a piece.
        max_health: units that a piece has at first, and when it comes back.
        respawn_steps: for how many steps an empty piece is away; None never brings it back.
        rew_type: "selfish" (what one ate) or "team_mean" (the mean of one's team; needs `TeamMembership`).
        scale: reward for a unit, or (low, high), of which every episode draws one.
        split: whether those who eat of one piece share a unit, instead of eating one each.
        observe_scale: whether the observation `food_scale` (1,) tells the reward for a unit.
        between: whether `radius` is measured from agents' "centres", or from their lower "corners", as published.

    Raises:
        ValueError: no food in the environment, a number out of its range, or a missing wrapper.
    """

    name = "eat_food"
    follows = (PreparationPhase,)

    def __init__(
        self,
        env: Environment,
        radius: float = 0.5,
        max_health: int = 10,
        respawn_steps: int | None = None,
        rew_type: str = "selfish",
        scale: float | tuple[float, float] = 1.0,
        split: bool = False,
        observe_scale: bool = False,
        between: str = "centres",
    ):
        super().__init__(env)
        self.food = self.module_of(Food)
        check_new_action(env, EAT)
        self.radius = float(check_value("radius", radius, Positive))
        self.max_health = int(check_value("max_health", max_health, PositiveCount))
        never = respawn_steps is None
        self.respawn_steps = None if never else int(check_value("respawn_steps", respawn_steps, PositiveCount))
        self.rew_type = check_choice("rew_type", rew_type, FOOD_REW_TYPES)
        self.scale = pair_of(check_value("scale", scale, NonNegativeRange))
        self.split = check_bool("split", split)
        self.observe_scale = check_bool("observe_scale", observe_scale)
        self.between = check_choice("between", between, BETWEEN)
        teams = self.inner(TeamMembership).team_index if rew_type == "team_mean" else np.arange(self.n_agents)
        self._same_team = teams[:, None] == teams

    @property
    def action_space(self) -> spaces.Dict:
        eat = spaces.MultiBinary((self.base.n_agents, self.food.n_max))
        return spaces.Dict({**self.env.action_space.spaces, EAT: eat})

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        return self.env.acts_on | {EAT: ((self.food.kind, self.food.n_max),)}

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        state = self.env.begin(key, params)
        n, n_food = self.base.n_agents, self.food.n_max
        low, high = self.scale
        scale = jax.random.uniform(named_key(key, self.name), (), minval=low, maxval=high)
        health = jnp.where(self._there(state), jnp.float32(self.max_health), 0.0)
        return self._observe(state, Meals(health, jnp.zeros(n_food, jnp.int32), jnp.zeros(n), scale))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        meals: Meals = state.mechanics[self.name]
        wants = (jnp.asarray(action[EAT]) > 0) & state.can_act[:, None]
        state = self.env.advance(state, {name: part for name, part in action.items() if name != EAT})
        eats = self.eating(state, meals.health, wants)
        n_eaters = eats.sum(axis=0)
        # Whole units, so that no crumbs are left by rounding.
        eaten = jnp.minimum(jnp.minimum(n_eaters, 1) if self.split else n_eaters, meals.health)
        bites = eats * (eaten / jnp.maximum(n_eaters, 1))
        health = meals.health - eaten
        if self.respawn_steps is not None:
            back = (meals.empty == self.respawn_steps) & self._there(state)
            health = jnp.where(back, jnp.float32(self.max_health), health)
        empty = jnp.where(health == 0, meals.empty + 1, 0)
        each = bites.sum(axis=1)
        state = state.replace(reward=state.reward + meals.scale * self._shared(state, each))
        return self._observe(state, Meals(health, empty, meals.eaten + each, meals.scale))

    def eating(self, state: State, health: jax.Array, wants: jax.Array) -> jax.Array:
        """Returns who eats of which piece: (n_agents, n_food) bool.

        Args:
            state: state after the step.
            health: (n_food,) units that are left.
            wants: (n_agents, n_food) bool, who asks for what.
        """
        mouths = state.data.xpos[self.base.agents.body_ids]
        if self.between == "corners":
            mouths -= jnp.asarray(self.base.agents.extent) / 2
        to = state.world.sites[self.food.kind] - mouths[:, None]
        near = jnp.linalg.norm(to, axis=-1) < self.radius
        return wants & near & (health > 0) & self.playing(state)[:, None]

    def _there(self, state: State) -> jax.Array:
        return state.world.active[self.food.kind]

    def _shared(self, state: State, each: jax.Array) -> jax.Array:
        """Returns every agent's part (n_agents,) of what its team ate; absent agents have none."""
        playing = self.playing(state)
        among = self._same_team & playing
        mean = (among * each).sum(axis=1) / jnp.maximum(among.sum(axis=1), 1)
        return jnp.where(playing, mean, 0.0)

    def _observe(self, state: State, meals: Meals) -> State:
        told = {"food_health": meals.health[:, None]}
        if self.observe_scale:
            told["food_scale"] = meals.scale[None]
        return self.remember(state, meals).replace(obs=state.obs | told)

    def declared(self) -> dict[str, Observed]:
        told = {"food_health": Observed((self.food.kind,), (Column("health", scale=float(self.max_health)),))}
        if self.observe_scale:
            told["food_scale"] = Observed((), (Column("reward for food", scale=max(self.scale[1], 1e-6)),))
        return self.env.declared() | told


class AlwaysEat(ActionWrapper):
    """Takes the choice of eating away: a team asks for all food at every step, others for none (as published).

    What stands between it and `EatFood`, such as `MaskActions`, still says what can be eaten.

    Args:
        env: environment to wrap.
        team: name or number of the team that eats; None is all agents.

    Raises:
        ValueError: no `EatFood` inside, or a team without agents.
    """

    name = "always_eat"
    requires = (EatFood,)

    def __init__(self, env: Environment, team: int | str | None = None):
        super().__init__(env)
        self._eats = np.ones(self.base.n_agents, bool)
        if team is not None:
            teams = self.inner(TeamMembership)
            self._eats = teams.of(team)
            if not self._eats.any():
                raise ValueError(f"team: got {team!r}; takes one of {list(teams.teams)}, or its number")
        self._n_food = self.inner(EatFood).food.n_max

    @property
    def action_space(self) -> spaces.Dict:
        return spaces.Dict({name: space for name, space in self.env.action_space.spaces.items() if name != EAT})

    @property
    def acts_on(self) -> dict[str, tuple[tuple[str, int], ...]]:
        return {name: kinds for name, kinds in self.env.acts_on.items() if name != EAT}

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        eat = np.broadcast_to(self._eats[:, None], (self.base.n_agents, self._n_food))
        return {**action, EAT: jnp.asarray(eat, jnp.int8)}
