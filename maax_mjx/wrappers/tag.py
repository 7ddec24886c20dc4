"""The rules of tag."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.checks import check_count, check_positive
from maax_mjx.common.keys import draw_one
from maax_mjx.common.observed import AGENT, Observed, flag
from maax_mjx.common.params import DomainParams
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.contact import AgentAgentContactMask2D
from maax_mjx.wrappers.preparation import PreparationPhase
from maax_mjx.wrappers.rewards import RestrictAgentsRect
from maax_mjx.wrappers.wrapper import Wrapper


class Tagged(struct.PyTreeNode):
    """The state of the game.

    Attributes:
        it: () int32, the agent that is it.
        safe: () int32, the agent that was it before; -1 for nobody.
        safe_for: () int32, steps for which that agent still cannot be tagged.
        tags: () int32, number of tags in this episode.
    """

    it: jax.Array
    safe: jax.Array
    safe_for: jax.Array
    tags: jax.Array


class Tag(Wrapper):
    """Tag: one agent is it, and passes that on by touching another.

    The first agent that is it is drawn; if several are touched at once, one of them is drawn. The agent that was it
    before cannot be tagged back for `immunity` steps. At every step the agent that is it then loses 1, which the others
    share. Adds the observation `is_it` (n_agents, 1) and `metrics["tags"]`.

    Args:
        env: environment to wrap.
        immunity: steps.
        scale: factor of the reward.

    Raises:
        ValueError: a negative immunity, a scale that is not positive, or no `AgentAgentContactMask2D` inside.
    """

    name = "tag"
    requires = (AgentAgentContactMask2D,)
    precedes = (PreparationPhase, RestrictAgentsRect)
    everyone_for_itself = True

    def __init__(self, env: Environment, immunity: int = 50, scale: float = 1.0):
        super().__init__(env)
        self.immunity = check_count("immunity", immunity)
        self.scale = check_positive("scale", scale)

    def begin(self, key: jax.Array, params: DomainParams) -> State:
        state = self.env.begin(key, params)
        none = jnp.full((), -1, jnp.int32)
        nothing = jnp.zeros((), jnp.int32)
        tagged = Tagged(draw_one(state.key, state.step, self.playing(state)), none, nothing, nothing)
        return self._observe(self.remember(state, tagged))

    def transition(self, state: State, action: Any) -> State:
        tagged: Tagged = state.mechanics[self.name]
        state = self.env.advance(state, action)
        players = jnp.arange(self.base.n_agents)
        safe = (players == tagged.safe) & (tagged.safe_for > 0)
        touched = state.mechanics[AgentAgentContactMask2D.name][tagged.it] & ~safe
        passed = touched.any()
        tagged = Tagged(
            it=jnp.where(passed, draw_one(state.key, state.step, touched), tagged.it),
            safe=jnp.where(passed, tagged.it, tagged.safe),
            safe_for=jnp.where(passed, self.immunity, jnp.maximum(tagged.safe_for - 1, 0)).astype(jnp.int32),
            tags=tagged.tags + passed,
        )
        state = self.remember(state, tagged)
        playing, is_it = self.playing(state), players == tagged.it
        share = 1 / jnp.maximum(playing.sum() - 1, 1)
        own = jnp.where(playing, jnp.where(is_it, -1.0, share), 0.0)
        return self._observe(state.replace(reward=state.reward + self.scale * own))

    def _observe(self, state: State) -> State:
        tagged: Tagged = state.mechanics[self.name]
        is_it = (jnp.arange(self.base.n_agents) == tagged.it).astype(jnp.float32)
        return state.replace(obs=state.obs | {"is_it": is_it[:, None]}, metrics=state.metrics | {"tags": tagged.tags})

    def declared(self) -> dict[str, Observed]:
        return self.env.declared() | {"is_it": Observed((AGENT,), flag("is it"), private=False)}
