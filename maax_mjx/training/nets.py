"""The networks of actors and critics: encoders of observations, a memory, and heads (flax linen)."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from maax_mjx.training.actions import Head
from maax_mjx.training.config import NetConfig
from maax_mjx.training.cores import Core
from maax_mjx.training.spec import Features

FILTERS, KERNEL = 9, 3
"""Of the circular convolution over lidar (Baker et al.)."""
SMALL = nn.initializers.orthogonal(0.01)


class Tower(nn.Module):
    """An actor or a critic: what it reads, its memory and its heads.

    Attributes:
        net: the form of the network.
        heads: parts of an action; empty for a critic, which puts out a "value".
    """

    net: NetConfig
    heads: tuple[Head, ...] = ()

    @nn.compact
    def __call__(
        self, features: Features, memory: jax.Array, begins: jax.Array
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """Reads some steps of some worlds.

        Args:
            features: with leading axes (n_steps, n_worlds, n_agents).
            memory: (n_worlds, n_agents, m) from before the first step.
            begins: (n_steps, n_worlds) bool, whether an episode begins at a step, so that nothing is remembered.

        Returns:
            What the heads put out, (n_steps, n_worlds, n_agents, width) by name, and the memory after the last step.
        """
        dtype = jnp.dtype(self.net.compute)
        masks = features.seen if self.heads else features.known
        parts = [features.own] + ([] if self.heads else [features.critic])
        if features.rays.shape[-1]:
            parts.insert(1, Lidar(dtype, name="lidar")(features.rays))
        own = jnp.concatenate(parts, axis=-1)
        tokens: dict[str, jax.Array] = {}
        if self.net.encoder == "flat":
            x = _flat(own, features.entities, masks, self.net, dtype)
        else:
            x, tokens = _entities(own, features.entities, masks, self.net, dtype)
        x = nn.LayerNorm(dtype=dtype, name="norm in")(x)
        x = nn.relu(nn.Dense(self.net.hidden, dtype=dtype, name="hidden")(x))
        x = nn.LayerNorm(dtype=dtype, name="norm hidden")(x)
        x, memory = Core(self.net, name="core")(x, memory, begins)
        if self.net.core != "none":
            x = nn.LayerNorm(dtype=dtype, name="norm out")(x)
        if not self.heads:
            value = nn.Dense(1, kernel_init=nn.initializers.orthogonal(1.0), name="value")(x.astype(jnp.float32))
            return {"value": value}, memory
        out: dict[str, jax.Array] = {}
        for head in self.heads:
            if head.kinds and tokens:
                out[head.name] = self._about_entities(head, x, tokens)
            else:
                out[head.name] = self._last(head.width, head.name)(x)
            if not head.bins:
                name = f"{head.name} log std"
                log_std = self.param(name, nn.initializers.constant(-0.5), (head.n,))
                out[name] = jnp.broadcast_to(log_std, (*x.shape[:-1], head.n))
        return out, memory

    def _about_entities(self, head: Head, x: jax.Array, tokens: dict[str, jax.Array]) -> jax.Array:
        """Returns logits (..., n * bins) of choices about entities, each from its own embedding."""
        layer = partial(nn.Dense, self.net.width, dtype=jnp.dtype(self.net.compute))
        own = layer(name=f"{head.name} own")(x)[..., None, :]
        rows = jnp.concatenate([tokens[kind] for kind, _ in head.kinds], axis=-2)
        each = layer(name=f"{head.name} entity", use_bias=False)(rows)
        logits = self._last(max(head.bins, 1), head.name)(nn.relu(own + each))
        return logits.reshape(*x.shape[:-1], head.width)

    def _last(self, width: int, name: str) -> nn.Dense:
        """A last layer, which puts out float32 whatever it is given."""
        dtype, product = jnp.dtype(self.net.compute), partial(jax.lax.dot_general, preferred_element_type=jnp.float32)
        return nn.Dense(width, kernel_init=SMALL, dtype=dtype, dot_general=product, name=name)


class Lidar(nn.Module):
    """A circular convolution over rays (Baker et al.), written as one product with the matrix that it is.

    Attributes:
        dtype: type of what it puts out.
    """

    dtype: Any

    @nn.compact
    def __call__(self, rays: jax.Array) -> jax.Array:
        """Turns (..., n_rays, c) into (..., n_rays * FILTERS)."""
        n, c = rays.shape[-2:]
        kernel = self.param("kernel", nn.initializers.lecun_normal(), (KERNEL, c, FILTERS))
        bias = self.param("bias", nn.initializers.zeros, (FILTERS,))
        # Which ray every filter's place reads at every position: (KERNEL, n, n).
        reads = np.stack([np.roll(np.eye(n, dtype=np.float32), i - KERNEL // 2, axis=0) for i in range(KERNEL)])
        product = jnp.einsum("kji,kcf->jcif", reads, kernel).reshape(n * c, n * FILTERS)
        found = rays.reshape(*rays.shape[:-2], n * c) @ product + jnp.tile(bias, n)
        return nn.relu(found.astype(self.dtype))


def _flat(
    own: jax.Array, entities: dict[str, jax.Array], masks: dict[str, jax.Array], net: NetConfig, dtype: Any
) -> jax.Array:
    """Joins everything, with zeros in place of what is masked."""
    lead = own.shape[:-1]
    rows = [jnp.where(masks[k][..., None], x, 0.0).reshape(*lead, -1) for k, x in entities.items()]
    shown = [masks[k].astype(own.dtype) for k in entities]
    x = jnp.concatenate([own, *rows, *shown], axis=-1)
    return nn.relu(nn.Dense(net.hidden, name="embed own")(x).astype(dtype))


def _entities(
    own: jax.Array, entities: dict[str, jax.Array], masks: dict[str, jax.Array], net: NetConfig, dtype: Any
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Embeds the agent and every entity, and takes them together.

    Returns:
        (..., k) and the entities' embeddings by kind.
    """
    # A layer of the agent and an entity joined, of which the agent's part is the same for all entities of a kind.
    # Products of first layers add up in float32; what they put out, and sums of it, have the type of the layers.
    first = nn.relu(nn.Dense(net.width, name="embed own")(own).astype(dtype))
    # Published is what the agent observes; its embedding says as much, and is a quarter as wide.
    joined, numbers = (own, jnp.float32) if net.encoder == "attend" else (first, dtype)
    tokens = {}
    for kind, x in entities.items():
        mine = nn.Dense(net.width, use_bias=False, dtype=numbers, name=f"embed own for {kind}")(joined)
        each = nn.Dense(net.width, name=f"embed {kind}")(jnp.where(masks[kind][..., None], x, 0.0)).astype(dtype)
        tokens[kind] = nn.relu(each + mine[..., None, :].astype(dtype))
    names, sizes = list(tokens), [x.shape[-2] for x in tokens.values()]
    everyone = jnp.concatenate([*tokens.values(), first[..., None, :]], axis=-2)
    there = jnp.concatenate([*(masks[k] for k in names), jnp.ones((*own.shape[:-1], 1), bool)], axis=-1)
    if net.encoder == "attend":
        everyone = _attended(everyone, there, net, dtype)
        mean = _mean(everyone, there)
        pooled = [mean]
    else:
        everyone = nn.LayerNorm(dtype=dtype, name="norm entities")(everyone)
        everyone = nn.relu(nn.Dense(net.width, dtype=dtype, name="entities")(everyone))
        # The agent itself is always there, so that there is a greatest.
        most = _greatest(everyone, there)
        pooled = [_mean(everyone, there), most]
    ends = [sum(sizes[: i + 1]) for i in range(len(sizes))]
    split = {k: everyone[..., end - n : end, :] for k, n, end in zip(names, sizes, ends, strict=True)}
    return jnp.concatenate([first, *pooled], axis=-1), split


def _mean(x: jax.Array, there: jax.Array) -> jax.Array:
    weights = there[..., None].astype(x.dtype)
    return (x * weights).sum(-2) / (weights.sum(-2) + 1e-5)


@jax.custom_vjp
def _greatest(x: jax.Array, there: jax.Array) -> jax.Array:
    """Returns the greatest (..., width) of entities (..., n, width) that are there.

    Its gradient goes to each of those that are as great, where JAX divides it by their number, which takes one
    more pass through them. As a rule there is one, or all are 0 after a relu, which passes no gradient on.
    """
    return jnp.where(there[..., None], x, -jnp.inf).max(-2)


def _greatest_forward(x: jax.Array, there: jax.Array) -> tuple[jax.Array, Any]:
    most = _greatest(x, there)
    return most, (x, there, most)


def _greatest_backward(kept: Any, gradient: jax.Array) -> tuple[jax.Array, None]:
    x, there, most = kept
    chosen = (x == most[..., None, :]) & there[..., None]
    return jnp.where(chosen, gradient[..., None, :], 0), None


_greatest.defvjp(_greatest_forward, _greatest_backward)


def _attended(x: jax.Array, there: jax.Array, net: NetConfig, dtype: Any) -> jax.Array:
    """Masked residual self-attention over entities (..., n, width), as Baker et al. published it."""
    size = net.width // net.heads
    init = nn.initializers.variance_scaling(0.125, "fan_in", "normal")
    y = nn.LayerNorm(dtype=dtype, name="norm before attention")(x)
    q_k = nn.Dense(2 * net.width, kernel_init=init, dtype=dtype, name="queries and keys")(y)
    q, k = jnp.split(q_k.reshape(*x.shape[:-1], net.heads, 2 * size), 2, axis=-1)
    v = nn.Dense(net.width, kernel_init=init, dtype=dtype, name="values")(y).reshape(*x.shape[:-1], net.heads, size)
    scores = jnp.einsum("...qhd,...khd->...hqk", q, k) / jnp.sqrt(size).astype(dtype)
    scores = jnp.where(there[..., None, None, :], scores.astype(jnp.float32), -1e10)
    # The agent itself is always there, so that no row is empty.
    weights = jax.nn.softmax(scores).astype(dtype)
    mixed = jnp.einsum("...hqk,...khd->...qhd", weights, v).reshape(x.shape)
    x = x + nn.Dense(net.width, kernel_init=init, dtype=dtype, name="attention out")(mixed)
    return nn.LayerNorm(dtype=dtype, name="norm after attention")(x)
