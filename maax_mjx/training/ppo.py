"""Proximal policy optimisation on a batch: the loss, minibatches of chunks, and the guard against broken updates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.flatten_util import ravel_pytree

from maax_mjx.training.actions import entropies, log_prob
from maax_mjx.training.collect import Batch
from maax_mjx.training.config import PPOConfig
from maax_mjx.training.network import Memory, Network, Weights

Mean = Callable[[Any], Any]
"""Averages arrays over devices."""


class Rows(struct.PyTreeNode):
    """Chunks of a batch, what updates draw from, with the leading axes (chunk, n_rows, n_agents), steps first.

    Attributes:
        features, action: what was seen and done.
        begins: (chunk, n_rows) bool.
        log_prob: log-probability of the action when it was taken.
        advantage, target: of the action, and for the critic in its own units.
        acts, counts: bool, which steps count for the policy and the critic.
        memory: (n_rows, n_agents, m) before the chunk.
    """

    features: Any
    action: dict[str, jax.Array]
    begins: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array
    acts: jax.Array
    counts: jax.Array
    memory: Any

    def picked(self, index: jax.Array) -> Rows:
        """Returns some of the rows by an index (..., n), whose other axes come before the steps."""
        first = index.ndim - 1
        with jax.named_scope("rows"):
            steps = jax.tree.map(lambda x: jnp.moveaxis(x[:, index], 0, first), self.replace(memory=()))
            return steps.replace(memory=jax.tree.map(lambda x: x[index], self.memory))


def rows_of(batch: Batch, before: Memory, advantage: jax.Array, target: jax.Array, chunk: int) -> Rows:
    """Cuts a batch into chunks.

    Args:
        batch: (n_steps, n_worlds, ...).
        before: memories before every chunk, (n_steps / chunk, n_worlds, ...).
        advantage, target: (n_steps, n_worlds, n_agents).
        chunk: steps of a chunk.

    Returns:
        Rows in the order of the worlds, so that a device's worlds are its rows.
    """
    steps = Rows(
        features=batch.features,
        action=batch.action,
        begins=batch.begins,
        log_prob=batch.log_prob,
        advantage=advantage,
        target=target,
        acts=batch.acts,
        counts=batch.counts,
        memory=(),
    )

    n_rows = batch.begins.size // chunk

    def cut(x: jax.Array) -> jax.Array:
        n_steps, n_worlds = x.shape[:2]
        x = jnp.moveaxis(x.reshape(n_steps // chunk, chunk, n_worlds, *x.shape[2:]), 0, 2)
        return x.reshape(chunk, n_rows, *x.shape[3:])

    first = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1).reshape(n_rows, *x.shape[2:]), before)
    return jax.tree.map(cut, steps).replace(memory=first)


def loss(weights: Weights, network: Network, ppo: PPOConfig, rows: Rows, total: Any) -> tuple[jax.Array, Any]:
    """Returns the loss of some rows, as a share of a whole minibatch, and diagnostics.

    Args:
        weights: the weights.
        network: the networks.
        ppo: the settings.
        rows: the rows.
        total: ("acts", "counts") how many agents' steps count in the whole minibatch, on all devices.
    """
    out, _ = network.actor(weights, rows.features, rows.memory.actor, rows.begins)
    value, _ = network.critic(weights, rows.features, rows.memory.critic, rows.begins)
    advantage, acts = rows.advantage, rows.acts

    def mean(x: jax.Array, where: jax.Array, n: jax.Array) -> jax.Array:
        return jnp.where(where, x, 0.0).sum() / jnp.maximum(n, 1.0)

    change = jnp.where(acts, log_prob(network.heads, out, rows.action) - rows.log_prob, 0.0)
    ratio = jnp.exp(change)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - ppo.clip, 1 + ppo.clip) * advantage)
    spread = entropies(network.heads, out)
    parts = {f"entropy_{name}": mean(x, acts, total["acts"]) for name, x in spread.items()}
    policy = mean(-gain, acts, total["acts"])
    error = mean((value - rows.target) ** 2, rows.counts, total["counts"])
    whole = policy + ppo.value * error - ppo.entropy * sum(parts.values())
    info = parts | {
        "loss_policy": policy,
        "loss_value": error,
        # Schulman's estimate of the divergence, which is never negative.
        "kl": mean(ratio - 1 - change, acts, total["acts"]),
        "clipped": mean((jnp.abs(ratio - 1) > ppo.clip).astype(jnp.float32), acts, total["acts"]),
    }
    return whole, info


def optimiser(ppo: PPOConfig) -> optax.GradientTransformation:
    """The optimiser of actors and critics, of all their weights as one vector (see `joined`)."""
    return optax.chain(optax.clip_by_global_norm(ppo.max_grad), optax.adam(ppo.lr, eps=1e-5))


def joined(weights: Weights) -> tuple[jax.Array, Callable[[jax.Array], dict[str, Any]]]:
    """Returns what is learnt as one vector, and the function that takes it apart.

    A network has hundreds of small arrays: array by array an update would be thousands of small operations, and XLA
    copies the guard over all arrays into the update of each, which took most of the compilation.
    """
    return ravel_pytree({"actor": weights.actor, "critic": weights.critic})


class Updates(struct.PyTreeNode):
    """What updates change.

    Attributes:
        weights: the weights.
        moments: the optimiser's state.
        stopped: () bool, whether the policy went too far, so that an iteration makes no more updates.
        broken: () int32, updates in a row that were not finite.
    """

    weights: Weights
    moments: Any
    stopped: jax.Array
    broken: jax.Array


def update(
    now: Updates, network: Network, ppo: PPOConfig, minibatch: Rows, mean: Mean
) -> tuple[Updates, dict[str, jax.Array]]:
    """Makes one update.

    Args:
        now: what it changes.
        network, ppo: the networks and settings.
        minibatch: rows with a leading axis (microbatches,).
        mean: averages over devices.

    Returns:
        The result and diagnostics; "taken" is 1 if the update was made, "broken" 1 if it was not finite.
    """
    sums = {"acts": minibatch.acts.sum(dtype=jnp.float32), "counts": minibatch.counts.sum(dtype=jnp.float32)}
    # Sums of all devices, over their number: gradients are averaged over devices afterwards.
    total = mean(sums)

    def trained(params: dict[str, Any], rows: Rows) -> tuple[jax.Array, Any]:
        return loss(now.weights.replace(**params), network, ppo, rows, total)

    params, apart = joined(now.weights)
    tree = apart(params)

    def add(so_far: Any, rows: Rows) -> tuple[Any, None]:
        (_, info), gradient = jax.value_and_grad(trained, has_aux=True)(tree, rows)
        return jax.tree.map(jnp.add, so_far, (gradient, info)), None

    first, others = jax.tree.map(lambda x: x[0], minibatch), jax.tree.map(lambda x: x[1:], minibatch)
    (_, info), gradients = jax.value_and_grad(trained, has_aux=True)(tree, first)
    if minibatch.begins.shape[0] > 1:
        (gradients, info), _ = jax.lax.scan(add, (gradients, info), others)
    gradient, info = mean((ravel_pytree(gradients)[0], info))
    with jax.named_scope("optimiser"):
        change, moments = optimiser(ppo).update(gradient, now.moments, params)
        new = optax.apply_updates(params, change)
    finite = jnp.isfinite(gradient).all() & jnp.isfinite(new).all()
    stopped = now.stopped | (info["kl"] > ppo.stop_kl if ppo.stop_kl is not None else False)
    taken = finite & ~stopped

    def chosen(new: Any, old: Any) -> Any:
        return jax.tree.map(lambda a, b: jnp.where(taken, a, b), new, old)

    weights = now.weights.replace(**apart(chosen(new, params)))
    broken = jnp.where(now.stopped, now.broken, jnp.where(finite, 0, now.broken + 1))
    info |= {
        "gradient": jnp.linalg.norm(gradient),
        "change": jnp.linalg.norm(change) / jnp.linalg.norm(params),
        "taken": taken.astype(jnp.float32),
        "broken": (~finite).astype(jnp.float32),
    }
    return Updates(weights, chosen(moments, now.moments), stopped, broken), info
