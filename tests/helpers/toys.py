"""Tiny games that show whether learning works, on the smallest worlds there are."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from gymnasium import spaces

import maax_mjx as maax
from maax_mjx import Column, Observed

QUIET = {"scenario": "empty", "outer": "none", "n_boxes": 0, "n_ramps": 0, "n_frames": 1}


class Echo(maax.Wrapper):
    """Agents see a sign in an episode's first step alone, and are paid in its last one for saying it.

    Only an agent that remembers can do better than by chance.
    """

    name = "echo"

    @property
    def action_space(self):
        return spaces.Dict({**self.env.action_space.spaces, "say": spaces.MultiBinary((self.n_agents,))})

    def begin(self, key, params):
        state = self.env.begin(key, params)
        return self._shown(self.remember(state, jax.random.bernoulli(state.key, shape=(self.n_agents,))))

    def transition(self, state, action):
        inner = {name: x for name, x in action.items() if name != "say"}
        after = self._shown(self.env.advance(state, inner))
        right = (jnp.asarray(action["say"]) > 0) == after.mechanics[self.name]
        return after.replace(reward=jnp.where(after.step == self.base.horizon, right * 2.0 - 1.0, 0.0))

    def _shown(self, state):
        sign = jnp.where(state.mechanics[self.name], 1.0, -1.0)
        return state.replace(obs=state.obs | {"sign": jnp.where(state.step == 0, sign, 0.0)[:, None]})

    def declared(self):
        return self.env.declared() | {"sign": Observed(("agent",), (Column("sign"),))}


def echo(horizon=4, impl="c"):
    """The game of `Echo`, with two agents that only see the sign and themselves."""
    env = maax.make("standard", n_hiders=1, n_seekers=1, horizon=horizon, impl=impl, **QUIET)
    return maax.SplitObservations(Echo(env))


class Unpaid(maax.RewardWrapper):
    """Pays what is not a number."""

    def reward(self, state):
        return jnp.full(self.base.n_agents, jnp.nan)


def unpaid():
    """The game of `Echo`, with rewards that are not numbers."""
    return Unpaid(echo())


@dataclass(frozen=True)
class EchoConfig:
    """Fields of the registered game "echo"."""

    horizon: int = 4
    impl: str = "c"


def register():
    """Gives the game of `Echo` its name, once."""
    if "echo" not in maax.tasks():
        maax.register("echo", lambda config: echo(config.horizon, config.impl), EchoConfig)
