"""Past opponents: earlier policies of a run that play one team in a share of the worlds."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.training.actions import sample
from maax_mjx.training.network import Network, Weights
from maax_mjx.training.spec import Features


def worlds_of_each(share: float, groups: int, n_worlds: int) -> int:
    """Returns in how many of a device's worlds each of some earlier policies plays, about a share of them in all."""
    return min(round(share * n_worlds / groups), n_worlds // groups)


class Opponents(struct.PyTreeNode):
    """Some earlier policies, and the worlds in which they play.

    Of the worlds on a device, the last ones form a block for every policy. In block g it plays team g, counted around.

    Attributes:
        weights: of the policies, with a leading axis (groups,).
        share: share of the worlds.
        groups: number of policies.
    """

    weights: Weights
    share: float = struct.field(pytree_node=False)
    groups: int = struct.field(pytree_node=False)

    def block(self, n_worlds: int) -> int:
        """Returns the number of worlds in each block."""
        return worlds_of_each(self.share, self.groups, n_worlds)

    def memory(self, network: Network, n_worlds: int) -> jax.Array:
        """Returns what they remember at the beginning of an episode."""
        return network.memory(self.groups * self.block(n_worlds)).actor

    def plays(self, network: Network, n_worlds: int) -> np.ndarray:
        """Returns which agents they play, (n_worlds, n_agents) bool."""
        team, n_teams, block = network.team_index, len(network.teams), self.block(n_worlds)
        theirs = np.zeros((n_worlds, network.n_agents), bool)
        first = n_worlds - self.groups * block
        for g in range(self.groups):
            theirs[first + g * block : first + (g + 1) * block] = team == g % n_teams
        return theirs


def frozen_actions(
    network: Network,
    opponents: Opponents,
    features: Features,
    begins: jax.Array,
    memory: jax.Array,
    action: dict[str, jax.Array],
    keys: jax.Array,
) -> tuple[dict[str, jax.Array], jax.Array, jax.Array]:
    """Puts the past opponents' actions in the place of the current policy's.

    Args:
        network: the networks.
        opponents: the opponents.
        features: (1, n_worlds, n_agents, ...).
        begins: (1, n_worlds) bool.
        memory: (groups * block, n_agents, m).
        action: the current policy's action for all agents.
        keys: (n_worlds,) keys of this step.

    Returns:
        The action, which agents the opponents play (n_worlds, n_agents) bool, and their next memory.
    """
    n, groups = begins.shape[1], opponents.groups
    block = opponents.block(n)
    theirs = jnp.asarray(opponents.plays(network, n))
    if not block:
        return action, theirs, memory
    first = n - groups * block

    def blocks(x: jax.Array) -> jax.Array:
        return x[first:].reshape(groups, block, *x.shape[1:])

    def play(weights: Weights, features: Features, memory: jax.Array, begins: jax.Array, keys: jax.Array) -> Any:
        now = jax.tree.map(lambda x: x[None], features)
        out, after = network.actor(weights, now, memory, begins[None])
        draw = jax.vmap(lambda one, key: sample(network.heads, one, jax.random.fold_in(key, 1)))
        return draw(jax.tree.map(lambda x: x[0], out), keys), after

    rows = jax.tree.map(lambda x: blocks(x[0]), features)
    remembered = memory.reshape(groups, block, *memory.shape[1:])
    chosen, after = jax.vmap(play)(opponents.weights, rows, remembered, blocks(begins[0]), blocks(keys))

    def put(mine: jax.Array, frozen: jax.Array) -> jax.Array:
        who = theirs.reshape(*theirs.shape, *[1] * (mine.ndim - 2))
        whole = jnp.concatenate([mine[:first], frozen.reshape(-1, *mine.shape[1:])])
        return jnp.where(who, whole, mine)

    return jax.tree.map(put, action, chosen), theirs, after.reshape(memory.shape)


class League:
    """The earlier policies of a run, on the host.

    Args:
        keep: number that is kept: of more, the oldest but the first goes.
    """

    def __init__(self, keep: int):
        self.keep = keep
        self.past: list[Weights] = []

    def add(self, weights: Weights) -> None:
        """Keeps a policy, on the host and without its critic."""
        self.past.append(jax.device_get(weights.replace(critic={})))
        if len(self.past) > self.keep:
            # The first stays, which is easily beaten, and shows whether that is unlearnt.
            del self.past[min(1, self.keep - 1)]

    def draw(self, seed: int, groups: int, share: float) -> Opponents:
        """Draws opponents, uniformly of those that are kept.

        Args:
            seed: determines the draw.
            groups: number of policies.
            share: share of the worlds.
        """
        rng = np.random.default_rng(seed)
        chosen = [self.past[i] for i in rng.integers(len(self.past), size=groups)]
        stacked = jax.tree.map(lambda *x: np.stack(x), *chosen)
        return Opponents(stacked, share, groups)
