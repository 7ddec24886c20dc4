"""Steps of all worlds under the current policy, kept as what it learns from."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.core.state import plain
from maax_mjx.parallel import Worlds, WorldsState
from maax_mjx.training.actions import log_prob, sample
from maax_mjx.training.config import PPOConfig
from maax_mjx.training.league import Opponents, frozen_actions
from maax_mjx.training.network import Memory, Network, Weights
from maax_mjx.training.returns import ValueScale
from maax_mjx.training.spec import Features
from maax_mjx.training.visited import Archive

FAULT = "physics_fault"


class Batch(struct.PyTreeNode):
    """What was seen, done and got, with the leading axes (n_steps, n_worlds), and (n_agents,) where agents differ.

    Attributes:
        features: what the networks read.
        begins: (n_steps, n_worlds) bool, whether an episode begins at the step.
        action: the action.
        log_prob: its log-probability.
        value: the critic's prediction, in its own units.
        after: the value after an episode that was cut off, in the critic's units; only for `bootstrap="horizon"`.
        reward: the reward of the step.
        end, last, fault: (n_steps, n_worlds) bool, whether the game was over, the episode, or rolled back.
        acts: bool, whether the policy learns from the step: the agent can act, unless `ppo.waiting` counts the others
            too, and is not played by another policy.
        counts: bool, whether the critic learns from it.
        metrics: (n_steps, n_worlds, ...) numbers of the game, by name.
        total: (n_steps, n_worlds, n_agents) reward of the episode so far.
        visited: (n_steps, n_worlds) bool, whether the episode began with a visited state.
    """

    features: Features
    begins: jax.Array
    action: dict[str, jax.Array]
    log_prob: jax.Array
    value: jax.Array
    after: jax.Array
    reward: jax.Array
    end: jax.Array
    last: jax.Array
    fault: jax.Array
    acts: jax.Array
    counts: jax.Array
    metrics: dict[str, jax.Array]
    total: jax.Array
    visited: jax.Array


class Remembered(struct.PyTreeNode):
    """What is remembered of worlds beside their states.

    Attributes:
        own: memory of the networks.
        opponents: memory of past opponents; () without.
        archive: visited states with which episodes begin; () without.
    """

    own: Memory
    opponents: Any
    archive: Any = ()


def collect(
    worlds: Worlds,
    network: Network,
    weights: Weights,
    opponents: Opponents | None,
    index: jax.Array,
    states: WorldsState,
    memory: Remembered,
    key: jax.Array,
    ppo: PPOConfig,
    share: float = 0.0,
) -> tuple[WorldsState, Remembered, Batch, Memory]:
    """Plays some steps.

    Args:
        worlds: the worlds.
        network, weights: the current policy.
        opponents: past policies, which play one team in some worlds; None without.
        index: (n,) indices of the worlds, which determine their draws.
        states: the worlds' states.
        memory: what is remembered of them.
        key: key of this iteration.
        ppo: the settings.
        share: share of the episodes that begin with a visited state of `memory.archive`.

    Returns:
        The states and memories after the steps; what happened, (n_steps, n_worlds, ...); and the networks' memories
        before every chunk, (n_steps / chunk, n_worlds, ...).
    """
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(index)
    archive: Archive | None = memory.archive if share else None
    begun = jnp.zeros_like(states.done) if archive is None else archive.begun

    Carry = tuple[WorldsState, Remembered, jax.Array]

    def step(carry: Carry, t: jax.Array) -> tuple[Carry, Batch]:
        states, memory, begun = carry
        features = network.spec.features(states.obs)
        now, begins = jax.tree.map(lambda x: x[None], (features, states.done))
        out, actor = network.actor(weights, now, memory.own.actor, begins)
        value, critic = network.critic(weights, now, memory.own.critic, begins)
        out = jax.tree.map(lambda x: x[0], out)
        draws = jax.vmap(lambda k: jax.random.fold_in(k, t))(keys)
        action = jax.vmap(partial(sample, network.heads))(out, draws)
        chances = log_prob(network.heads, out, action)
        theirs = jnp.zeros(chances.shape, bool)
        frozen = memory.opponents
        if opponents is not None:
            action, theirs, frozen = frozen_actions(network, opponents, now, begins, frozen, action, draws)
        visited = None if archive is None else archive.beginnings(states, share, draws)
        after = worlds.step_fn(states, action, visited)
        fault = after.metrics[FAULT]
        cut = jnp.zeros_like(value[0])
        if ppo.bootstrap == "horizon":
            final = jax.tree.map(lambda x: x[None], network.spec.features(after.final_obs))
            cut = network.critic(weights, final, critic, jnp.zeros_like(begins))[0][0]
        playing, acting = plain(states).active, states.can_act
        batch = Batch(
            features=features,
            begins=states.done,
            action=action,
            log_prob=chances,
            value=value[0],
            after=cut,
            reward=after.reward,
            end=after.terminated | (after.truncated & (ppo.bootstrap == "end")),
            last=after.done,
            fault=fault,
            acts=(playing if ppo.waiting else acting) & ~theirs & ~fault[:, None],
            counts=playing & ~theirs & ~fault[:, None],
            metrics=after.metrics,
            total=after.episode_return,
            visited=begun,
        )
        if visited is not None:
            begun = jnp.where(after.done, visited.taken, begun)
        return (after, Remembered(Memory(actor, critic), frozen), begun), batch

    def run(carry: Carry, times: jax.Array) -> tuple[Carry, tuple[Batch, Memory]]:
        before = carry[1].own
        carry, batch = jax.lax.scan(step, carry, times)
        return carry, (batch, before)

    times = jnp.arange(ppo.unroll).reshape(-1, ppo.chunk)
    start = states, memory.replace(archive=()), begun
    (states, now, begun), (batch, before) = jax.lax.scan(run, start, times)
    now = now.replace(archive=() if archive is None else archive.replace(begun=begun))
    return states, now, jax.tree.map(lambda x: x.reshape(ppo.unroll, *x.shape[2:]), batch), before


def last_value(
    network: Network, weights: Weights, scale: ValueScale, states: WorldsState, memory: Remembered
) -> jax.Array:
    """Returns what the critic expects after the last step, in units of rewards: (n_worlds, n_agents)."""
    now, begins = jax.tree.map(lambda x: x[None], (network.spec.features(states.obs), states.done))
    return scale.denormalised(network.critic(weights, now, memory.own.critic, begins)[0][0])
