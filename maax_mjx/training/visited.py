"""Visited states as beginnings of episodes: the more wrong the critic was there, the more likely they are kept."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.keys import as_key, keyless, named_key
from maax_mjx.core.env import Environment
from maax_mjx.core.state import plain
from maax_mjx.parallel.episodes import Visited, WorldsState, beginning

CHOICE = 4
"""States that are looked at for one that is kept."""


class Archive(struct.PyTreeNode):
    """Visited states on each device, the newest first.

    Attributes:
        state: (size, ...) states, with the data of keys in the place of keys.
        there: (size,) bool, which of them were visited; all after some iterations.
        begun: (n_worlds,) bool, whether the running episode of a world began with a visited state.
    """

    state: Any
    there: jax.Array
    begun: jax.Array

    @classmethod
    def empty(cls, env: Environment, size: int, n_worlds: int) -> Archive:
        """An archive in which nothing is yet, on all devices together."""
        shape = jax.eval_shape(_stored, env.state_shape)
        state = jax.tree.map(lambda x: jnp.zeros((size, *x.shape), x.dtype), shape)
        return cls(state, jnp.zeros(size, bool), jnp.zeros(n_worlds, bool))

    def beginnings(self, states: WorldsState, share: float, keys: jax.Array) -> Visited:
        """Draws with which visited state every world would begin, and in which worlds, a share of them, it does.

        Args:
            states: of this device's worlds, with keys where a state has them.
            share: share of the episodes.
            keys: (n_worlds,) keys of this step.
        """
        draws = jax.vmap(lambda key: jax.random.uniform(named_key(key, "visited"), (2,)))(keys)
        n = self.there.sum()
        index = jnp.minimum((draws[:, 0] * n).astype(jnp.int32), jnp.maximum(n - 1, 0))
        # Archives of several devices that became one have gaps until they are full.
        index = jnp.argsort(~self.there)[index]
        state = jax.tree.map(as_key, self.state, beginning(plain(states)))
        return Visited(state, index, (draws[:, 1] < share) & (n > 0))

    def kept(self, candidates: Any, score: jax.Array, n_new: int, key: jax.Array) -> Archive:
        """Returns the archive with some new states in the place of the oldest.

        Args:
            candidates: (n, ...) states as `looked_at` gives them.
            score: (n,) in proportion to which each is the first to be chosen.
            n_new: how many are chosen.
            key: key of the draw.
        """
        # The greatest of logarithms with Gumbel's noise are a draw without putting back.
        chances = jnp.log(jnp.maximum(score, 1e-8)) + jax.random.gumbel(key, score.shape)
        _, chosen = jax.lax.top_k(chances, n_new)
        new = jax.tree.map(lambda x: x[chosen], candidates)
        state = jax.tree.map(lambda a, b: jnp.concatenate([a, b[:-n_new]]), new, self.state)
        return self.replace(state=state, there=jnp.concatenate([jnp.ones(n_new, bool), self.there[:-n_new]]))


def looked_at(states: WorldsState, n_new: int, key: jax.Array) -> tuple[Any, jax.Array]:
    """Draws states of some of a device's worlds, of which the archive may keep some.

    Args:
        states: of the worlds.
        n_new: how many of them the archive is to keep.
        key: key of the draw.

    Returns:
        The states, and the worlds (n,) that they are of.
    """
    worlds = jax.random.permutation(key, len(states.step))[: CHOICE * n_new]
    return jax.tree.map(lambda x: x[worlds], _stored(states)), worlds


def surprise(gain: jax.Array, counts: jax.Array) -> jax.Array:
    """Returns how wrong the critic was in every world, the mean of the advantages' sizes over agents that count.

    Prioritised level replay (Jiang et al. 2021) has a score like it, over whole episodes.

    Args:
        gain: (n_worlds, n_agents) advantages, in units of rewards.
        counts: (n_worlds, n_agents) bool.
    """
    return jnp.where(counts, jnp.abs(gain), 0.0).sum(-1) / jnp.maximum(counts.sum(-1), 1)


def _stored(states: Any) -> Any:
    return keyless(beginning(plain(states)))
