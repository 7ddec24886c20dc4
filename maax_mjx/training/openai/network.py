"""The published policies' network: entities that attend to each other, and an LSTM.

Layers have numbers in the names of their variables: what comes before the attention embeds what is observed, what comes
after it is a chain from the pooled entities to the memory. The networks of both published games differ in that chain
and in their layer norms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

HEADS = 4
"""Heads of the attention; no variable tells it."""
KINDS = ("agent_qpos_qvel", "box_obs", "ramp_obs", "construction_site_obs")
MASKS = ("mask_aa_obs", "mask_ab_obs", "mask_ar_obs", "mask_acs_obs_spoof")
"""Kinds of entities, in the order of the embeddings, and the masks of what of them is seen. Sites are blueprint's."""
CLIP = 5.0
LEAST_VARIANCE = 1e-2
LEAST_WEIGHT = 1e-6
NORM_EPSILON = 1e-12
POOL_EPSILON = 1e-5
SOFTMAX_EPSILON = 1e-10
FAR = 1e10
NET = "policy_net"
ACTIONS = ("action_movement", "action_pull", "action_glueall")

Weights = Mapping[str, jax.Array]


@dataclass(frozen=True)
class OpenAINetwork:
    """A published network, as the names of its variables tell it.

    Attributes:
        convolution: layer of the lidar's convolution.
        embeddings: layers of the embeddings, one for every kind of entity.
        own_embedding: the layer that embeds the agent itself.
        attention: layer of the attention, with its block.
        chain: layers after the attention, in their order.
        memory_size: numbers that an agent remembers.
        n_bins: bins of every part of the movement.
        widths: columns of an agent's own observation, and of an entity of every kind.
        n_rays: number of rays.
    """

    convolution: str
    embeddings: tuple[str, ...]
    own_embedding: str
    attention: str
    chain: tuple[str, ...]
    memory_size: int
    n_bins: int
    widths: tuple[int, ...]
    n_rays: int

    @property
    def masks(self) -> dict[str, str]:
        """Kinds of entities, and their masks."""
        return dict(zip(KINDS[: len(self.embeddings)], MASKS, strict=False))

    def __call__(
        self, weights: Weights, obs: Mapping[str, jax.Array], memory: jax.Array
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """Computes the logits of all agents' actions.

        Args:
            weights: variables by name.
            obs: published observations by name, (n_agents, ...) each.
            memory: (n_agents, memory_size), cell and output of the LSTM.

        Returns:
            Logits by action, (n_agents, n) each, and the next memory.
        """
        own = _normalised(weights, "self_obs", "obsfilter", obs["observation_self"])
        lidar = _normalised(weights, "lidar", "obsfilter/lidar", obs["lidar"])
        rays = _convolved(weights, f"{NET}/{self.convolution}/conv1d", lidar)
        main = jnp.concatenate([own, rays.reshape(len(rays), -1)], axis=-1)
        layers = zip(self.embeddings, self.masks, strict=True)
        entities = [self._embedded(weights, layer, kind, obs[kind], main) for layer, kind in layers]
        main = jax.nn.relu(_dense(weights, f"{NET}/{self.own_embedding}", main))
        masks = [obs[mask] for mask in self.masks.values()]
        mask = jnp.concatenate([*masks, jnp.ones((len(main), 1))], axis=1)
        x = self._attended(weights, jnp.concatenate([*entities, main[:, None]], axis=1), mask)
        pooled = (x * mask[..., None]).sum(axis=1) / (mask.sum(axis=1, keepdims=True) + POOL_EPSILON)
        x = jnp.concatenate([main, pooled], axis=-1)
        for layer in self.chain:
            scope = f"{NET}/{layer}"
            if layer.startswith("layernorm"):
                x = _layer_norm(weights, f"{scope}/LayerNorm", x)
            elif layer.startswith("dense"):
                x = jax.nn.relu(_dense(weights, scope, x))
            else:
                x, memory = _lstm(weights, f"{scope}/rnn/basic_lstm_cell", x, memory)
        return {action: _dense(weights, f"policy_out/{action}/dense", x) for action in ACTIONS}, memory

    def _embedded(self, weights: Weights, layer: str, kind: str, x: jax.Array, main: jax.Array) -> jax.Array:
        x = _normalised(weights, kind, f"obsfilter/{kind}", x)
        around = jnp.broadcast_to(main[:, None], (*x.shape[:2], main.shape[-1]))
        return jax.nn.relu(_dense(weights, f"{NET}/{layer}", jnp.concatenate([around, x], axis=-1)))

    def _attended(self, weights: Weights, x: jax.Array, mask: jax.Array) -> jax.Array:
        scope = f"{NET}/{self.attention}"
        qkv = f"{scope}/self_attention/qkv_embed"
        before = _layer_norm(weights, f"{qkv}/pre_sa_layer_norm/LayerNorm", x)
        # Queries and keys take turns in the columns of one matrix.
        qk = _dense(weights, f"{qkv}/qk_embed", before)
        qk = qk.reshape(*x.shape[:2], HEADS, -1, 2)
        query, key = qk[..., 0], qk[..., 1]
        value = _dense(weights, f"{qkv}/v_embed", before).reshape(*x.shape[:2], HEADS, -1)
        logits = jnp.einsum("aihf,ajhf->ahij", query, key) / np.sqrt(query.shape[-1])
        seen = mask[:, None, None]
        logits = logits - (1 - seen) * FAR
        share = jnp.exp(logits - logits.max(axis=-1, keepdims=True)) * seen
        share = share / (share.sum(axis=-1, keepdims=True) + SOFTMAX_EPSILON) * seen
        found = jnp.einsum("ahij,ajhf->aihf", share, value).reshape(x.shape)
        x = x + _dense(weights, f"{scope}/mlp1", found)
        return _layer_norm(weights, f"{scope}/post_a_layernorm/LayerNorm", x)


def _normalised(weights: Weights, name: str, scope: str, x: jax.Array) -> jax.Array:
    """Takes away the mean of training and divides by the deviation, both from averages that began with zeros."""
    mean, square, weight = (weights[f"normalize_{name}/{scope}/{part}"] for part in ("mean", "sq", "debiasing_term"))
    weight = jnp.maximum(weight, LEAST_WEIGHT)
    mean = mean / weight
    deviation = jnp.sqrt(jnp.maximum(square / weight - mean**2, LEAST_VARIANCE))
    return jnp.clip((x - mean) / deviation, -CLIP, CLIP)


def _dense(weights: Weights, scope: str, x: jax.Array) -> jax.Array:
    return x @ weights[f"{scope}/kernel"] + weights[f"{scope}/bias"]


def _layer_norm(weights: Weights, scope: str, x: jax.Array) -> jax.Array:
    """Layer norm over the last axis; without its variables nothing, as in the quadrant's network."""
    if f"{scope}/gamma" not in weights:
        return x
    mean = x.mean(axis=-1, keepdims=True)
    variance = ((x - mean) ** 2).mean(axis=-1, keepdims=True)
    return (x - mean) / jnp.sqrt(variance + NORM_EPSILON) * weights[f"{scope}/gamma"] + weights[f"{scope}/beta"]


def _convolved(weights: Weights, scope: str, x: jax.Array) -> jax.Array:
    """Convolution (n, n_rays, n_filters) along rays (n, n_rays, 1), whose last is beside the first."""
    kernel = weights[f"{scope}/kernel"]
    reach = kernel.shape[0] // 2
    around = jnp.concatenate([x[:, -reach:], x, x[:, :reach]], axis=1)
    parts = [around[:, i : i + x.shape[1]] @ kernel[i] for i in range(kernel.shape[0])]
    return jax.nn.relu(sum(parts) + weights[f"{scope}/bias"])


def _lstm(weights: Weights, scope: str, x: jax.Array, memory: jax.Array) -> tuple[jax.Array, jax.Array]:
    cell, out = jnp.split(memory, 2, axis=-1)
    gates = _dense(weights, scope, jnp.concatenate([x, out], axis=-1))
    i, j, f, o = jnp.split(gates, 4, axis=-1)
    cell = jax.nn.sigmoid(f + 1) * cell + jax.nn.sigmoid(i) * jnp.tanh(j)
    out = jax.nn.sigmoid(o) * jnp.tanh(cell)
    return out, jnp.concatenate([cell, out], axis=-1)
