"""Observations for every agent: what it knows of itself, of others, of objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.observed import AGENT, Observed, check_shapes, declaration
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.wrapper import ObservationWrapper, layers

OTHER = "other"
"""The axis of the other agents."""


class SplitObservations(ObservationWrapper):
    """Gives every agent observations of its own: every array's first axis becomes the agents' (Baker et al.).

    It goes by what is declared (`env.observed`):

    - what agents know of themselves and see of each other becomes `<name>_self` (n_agents, ...) and `<name>`
      (n_agents, n_agents - 1, ...); the others stand in circulant order: i - 1, i - 2, ... modulo n_agents.
    - what is private stays, (n_agents, ...), for its agent alone; matrices of agents by agents lose oneself.
    - what all share is repeated for each, (n_agents, ...).
    - all columns about one kind of object stand in `<kind>_obs` (n_agents, n, ...): where it is, and what mechanics
      add, such as locks and holds.
    - what says nothing new (`derived`) is left out.

    Args:
        env: what to wrap.

    Raises:
        ValueError: an observation that is not declared, or that has another shape than was declared.
    """

    name = "split_observations"

    def __init__(self, env: Environment):
        super().__init__(env)
        table = declared_table(env, "SplitObservations")
        n = env.base.n_agents
        self._others = (np.arange(n)[:, None] - np.arange(1, n)) % n
        self._table = {name: one for name, one in table.items() if not one.derived}
        self._joined = _joined(self._table)

    def observation(self, state: State) -> dict[str, jax.Array]:
        n = self.base.n_agents
        split: dict[str, jax.Array] = {}
        for name, one in self._table.items():
            x = state.obs[name]
            if one.is_of_agents and not one.private:
                split |= {f"{name}_self": x, name: x[self._others]}
            elif one.axes[:2] == (AGENT, AGENT):
                split[name] = x[np.arange(n)[:, None], self._others]
            else:
                split[name] = x if one.is_of_agents else jnp.broadcast_to(x, (n, *x.shape))
        for whole, parts in self._joined.items():
            split[whole] = jnp.concatenate([split.pop(part).astype(jnp.float32) for part in parts], axis=-1)
        return split

    def declared(self) -> dict[str, Observed]:
        split: dict[str, Observed] = {}
        for name, one in self._table.items():
            if one.is_of_agents and not one.private:
                split[f"{name}_self"] = replace(one, private=True, present=None, seen=None)
                split[name] = replace(one, axes=(AGENT, OTHER, *one.axes[1:]), private=True)
            elif one.axes[:2] == (AGENT, AGENT):
                split[name] = replace(one, axes=(AGENT, OTHER, *one.axes[2:]))
            else:
                split[name] = replace(one, axes=one.axes if one.is_of_agents else (AGENT, *one.axes), private=True)
        for whole, parts in self._joined.items():
            every = [split.pop(part) for part in parts]
            columns = tuple(column for one in every for column in one.columns)
            split[whole] = replace(every[0], columns=columns)
        return split


def declared_table(env: Environment, who: str) -> dict[str, Observed]:
    """What an environment observes, all of it declared and of the declared shapes.

    Args:
        env: the environment.
        who: needs it, for the messages.

    Raises:
        ValueError: naming what is not declared, where it comes from, and the line that declares it.
    """
    table, space = env.observed, env.observation_space.spaces
    shapes = {name: sub.shape or () for name, sub in space.items()}
    for name, shape in shapes.items():
        if name not in table:
            source, call = _origin(env, name)
            line = declaration(name, shape, env.base.n_agents)
            raise ValueError(
                f"{who}: {name!r} is observed and not declared; say whose it is, in {source}: "
                f"def declared(self): return {call}{line}"
            )
    check_shapes(table, shapes, who)
    return {name: one for name, one in table.items() if name in shapes}


def _origin(env: Environment, name: str) -> tuple[str, str]:
    """The class that observes something, and what its `declared` begins with."""
    inner = [layer for layer in layers(env) if name in layer.observation_space.spaces]
    if inner and name not in env.base.observation_space.spaces:
        return type(inner[-1]).__name__, "self.env.declared() | "
    for module in env.base.modules.values():
        shapes = jax.eval_shape(module.observation_step, env.base.state_shape.world, env.base.state_shape.data)
        if name in shapes:
            return type(module).__name__, ""
    return type(env).__name__, "self.env.declared() | "


def _joined(table: Mapping[str, Observed]) -> dict[str, list[str]]:
    """Of every kind of object that has `<kind>_obs`, the names of all arrays of columns about it."""
    joined: dict[str, list[str]] = {}
    for name, one in table.items():
        own = one.axes[1:] if one.axes[:1] == (AGENT,) else one.axes
        if one.columns and not one.critic and len(own) == 1 and own[0] != AGENT and f"{own[0]}_obs" in table:
            joined.setdefault(f"{own[0]}_obs", []).append(name)
    return {whole: parts for whole, parts in joined.items() if len(parts) > 1}
