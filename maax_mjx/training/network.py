"""A game's networks: which agents share parameters, and how observations are standardised before them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.core.env import Environment
from maax_mjx.training.actions import Head, heads_of
from maax_mjx.training.config import NetConfig
from maax_mjx.training.cores import memory_size
from maax_mjx.training.nets import Tower
from maax_mjx.training.spec import CLIP, Features, Spec, spec_of

EVERYONE = "agents"
"""Name of the one set of parameters that all agents share."""
NORM_DECAY, LEAST_VARIANCE = 0.99, 0.01


class Moments(struct.PyTreeNode):
    """Running moments of the features, each with its last axis alone, and what they have seen, from 0 to 1."""

    mean: dict[str, jax.Array]
    square: dict[str, jax.Array]
    weight: jax.Array


class Weights(struct.PyTreeNode):
    """Everything that a network knows.

    Attributes:
        actor, critic: parameters, by the name of the agents that share them.
        norm: running moments of the features; () without.
    """

    actor: dict[str, Any]
    critic: dict[str, Any]
    norm: Any


class Memory(struct.PyTreeNode):
    """What the networks remember of some worlds, (n_worlds, n_agents, m) each."""

    actor: jax.Array
    critic: jax.Array


@dataclass(frozen=True)
class Network:
    """The networks of a game, as pure functions of their weights; equal ones share compiled programs.

    Attributes:
        spec: what they read.
        heads: what they decide.
        net: their form.
        teams: names and slots of the teams.
    """

    spec: Spec
    heads: tuple[Head, ...]
    net: NetConfig
    teams: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, env: Environment, net: NetConfig) -> Network:
        """The networks of an environment.

        Raises:
            ValueError: observations or actions that networks cannot read or make.
        """
        teams = tuple((team.name, team.slots) for team in env.teams.values())
        spec = spec_of(env)
        return cls(spec, heads_of(env, spec), net, teams or ((EVERYONE, tuple(range(env.n_agents))),))

    @property
    def n_agents(self) -> int:
        """Number of agents."""
        return sum(len(slots) for _, slots in self.teams)

    @property
    def groups(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """Names and slots of the agents that share parameters."""
        return self.teams if self.net.share == "team" else ((EVERYONE, tuple(range(self.n_agents))),)

    @property
    def team_index(self) -> np.ndarray:
        """(n_agents,) team of every slot."""
        index = np.zeros(self.n_agents, int)
        for i, (_, slots) in enumerate(self.teams):
            index[list(slots)] = i
        return index

    def memory(self, n_worlds: int) -> Memory:
        """The memory at the beginning of an episode."""
        # In separate memory, since it is donated.
        return Memory(*(jnp.zeros((n_worlds, self.n_agents, memory_size(self.net))) for _ in range(2)))

    @partial(jax.jit, static_argnums=0)
    def draw(self, key: jax.Array) -> Weights:
        """Draws weights."""
        features = self.spec.shapes(self.n_agents)
        one = jax.tree.map(lambda x: jnp.zeros((1, 1, *x.shape), x.dtype), features)
        begins = jnp.zeros((1, 1), bool)

        def tower(heads: tuple[Head, ...], key: jax.Array) -> dict[str, Any]:
            params = {}
            for i, (name, slots) in enumerate(self.groups):
                mine = _of(one, slots)
                memory = jnp.zeros((1, len(slots), memory_size(self.net)))
                params[name] = Tower(self.net, heads).init(jax.random.fold_in(key, i), mine, memory, begins)["params"]
            return params

        first, second = jax.random.split(key)
        norm: Any = ()
        if self.net.norm == "running":
            zeros = {name: jnp.zeros(x.shape[-1]) for name, x in _named(features).items()}
            norm = Moments(zeros, dict(zeros), jnp.zeros(()))
        return Weights(tower(self.heads, first), tower((), second), norm)

    def actor(
        self, weights: Weights, features: Features, memory: jax.Array, begins: jax.Array
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """Returns what the policy puts out, (n_steps, n_worlds, n_agents, width) by name, and its next memory.

        Args:
            weights: the weights.
            features: (n_steps, n_worlds, n_agents, ...).
            memory: (n_worlds, n_agents, m).
            begins: (n_steps, n_worlds) bool, whether an episode begins at a step.
        """
        return self._run(self.heads, weights.actor, standardised(weights.norm, features), memory, begins)

    def critic(
        self, weights: Weights, features: Features, memory: jax.Array, begins: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Returns predictions in the critic's own units, (n_steps, n_worlds, n_agents), and its next memory."""
        out, memory = self._run((), weights.critic, standardised(weights.norm, features), memory, begins)
        return out["value"][..., 0], memory

    def _run(
        self, heads: tuple[Head, ...], params: dict[str, Any], features: Features, memory: jax.Array, begins: jax.Array
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        tower: Any = Tower(self.net, heads)
        if len(self.groups) == 1:
            ((name, _),) = self.groups
            return tower.apply({"params": params[name]}, features, memory, begins)
        outs, memories = [], []
        for name, slots in self.groups:
            index = jnp.asarray(slots)
            out, after = tower.apply({"params": params[name]}, _of(features, slots), memory[:, index], begins)
            outs.append(out)
            memories.append(after)
        back = np.argsort(np.concatenate([slots for _, slots in self.groups]))
        joined = {k: jnp.concatenate([out[k] for out in outs], axis=2)[:, :, back] for k in outs[0]}
        return joined, jnp.concatenate(memories, axis=1)[:, back]


def _of(features: Features, slots: tuple[int, ...]) -> Features:
    """Returns the features of some agents; the agents' axis is the third one."""
    return jax.tree.map(lambda x: x[:, :, np.asarray(slots)], features)


def _named(features: Features) -> dict[str, jax.Array]:
    """The numbers among the features, by name."""
    named = {"own": features.own, "rays": features.rays, "critic": features.critic}
    return named | {f"entities {kind}": x for kind, x in features.entities.items()}


def standardised(norm: Any, features: Features) -> Features:
    """Returns the features in units of their running moments; as they are without."""
    if isinstance(norm, tuple):
        return features
    weight = jnp.maximum(norm.weight, 1e-8)

    def one(name: str, x: jax.Array) -> jax.Array:
        mean = norm.mean[name] / weight
        std = jnp.sqrt(jnp.maximum(norm.square[name] / weight - mean * mean, LEAST_VARIANCE))
        return jnp.where(norm.weight > 0, jnp.clip((x - mean) / std, -CLIP, CLIP), x)

    named = {name: one(name, x) for name, x in _named(features).items()}
    entities = {kind: named[f"entities {kind}"] for kind in features.entities}
    return features.replace(own=named["own"], rays=named["rays"], critic=named["critic"], entities=entities)


def updated(norm: Any, features: Features, mean: Callable[[jax.Array], jax.Array]) -> Any:
    """Returns the moments after some more features; `mean` averages a number over devices."""
    if isinstance(norm, tuple):
        return norm
    means, squares = {}, {}
    for name, x in _named(features).items():
        kind = name.removeprefix("entities ")
        there = features.known[kind][..., None] if kind in features.known else jnp.ones((*x.shape[:-1], 1), bool)
        axes = tuple(range(x.ndim - 1))
        n = jnp.maximum(mean(there.sum(dtype=jnp.float32)), 1.0)
        means[name] = mean(jnp.where(there, x, 0.0).sum(axes)) / n
        squares[name] = mean(jnp.where(there, x * x, 0.0).sum(axes)) / n
    keep, new = NORM_DECAY, 1 - NORM_DECAY
    decayed = [
        {k: keep * old[k] + new * now[k] for k in old} for old, now in ((norm.mean, means), (norm.square, squares))
    ]
    return Moments(decayed[0], decayed[1], keep * norm.weight + new)
