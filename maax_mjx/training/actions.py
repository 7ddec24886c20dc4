"""The joint distribution of all parts of an agent's action, given the numbers that a network puts out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import log, tau

import jax
import jax.numpy as jnp
from gymnasium import spaces

from maax_mjx.core.env import Environment
from maax_mjx.training.spec import Spec


@dataclass(frozen=True)
class Head:
    """One part of an action: some independent choices, or some numbers.

    Attributes:
        name: the part's name, such as "move".
        n: how many choices or numbers an agent has.
        bins: options of each choice; 0 for numbers, which are normally distributed.
        shape: shape of one agent's part in the environment's action: () or (n,).
        kinds: kinds of the entities that the choices are about, in order, with their numbers; empty for other choices.
    """

    name: str
    n: int
    bins: int
    shape: tuple[int, ...]
    kinds: tuple[tuple[str, int], ...] = ()

    @property
    def width(self) -> int:
        """Numbers that a network puts out for it: logits (n * bins), or means (n)."""
        return self.n * max(self.bins, 1)


def heads_of(env: Environment, spec: Spec) -> tuple[Head, ...]:
    """Returns the parts of an agent's action; choices about entities that are observed know which those are.

    Raises:
        ValueError: a part without a row per agent.
    """
    heads = []
    for name, space in env.action_space.spaces.items():
        shape = tuple(space.shape or ())
        if shape[:1] != (env.n_agents,) or len(shape) > 2:
            raise ValueError(f"env: its action {name!r} has shape {shape}; takes a row per agent, ({env.n_agents}, n)")
        n = shape[1] if len(shape) == 2 else 1
        if isinstance(space, spaces.MultiDiscrete):
            bins = int(space.nvec.flat[0])
        elif isinstance(space, spaces.MultiBinary):
            bins = 2
        else:
            bins = 0
        kinds = env.acts_on.get(name, ())
        observed = {kind.name: kind.n for kind in spec.kinds}
        if not all(observed.get(kind) == number for kind, number in kinds):
            kinds = ()
        heads.append(Head(name, n, bins, shape[1:], tuple(kinds)))
    return tuple(heads)


def _logits(head: Head, x: jax.Array) -> jax.Array:
    """Returns log-probabilities (..., n, bins) in float32."""
    return jax.nn.log_softmax(x.astype(jnp.float32).reshape(*x.shape[:-1], head.n, head.bins))


def sample(heads: tuple[Head, ...], out: Mapping[str, jax.Array], key: jax.Array) -> dict[str, jax.Array]:
    """Draws an action.

    Args:
        heads: the parts.
        out: what a network puts out, by name: (..., width); "<name> log std" (..., n) for numbers.
        key: a key.

    Returns:
        By name (..., *shape), int32 for choices, float32 for numbers.
    """
    action = {}
    for head, k in zip(heads, jax.random.split(key, len(heads)), strict=True):
        x = out[head.name]
        if head.bins:
            drawn = jax.random.categorical(k, _logits(head, x)).astype(jnp.int32)
        else:
            noise = jax.random.normal(k, x.shape, jnp.float32)
            drawn = x.astype(jnp.float32) + jnp.exp(out[f"{head.name} log std"]) * noise
        action[head.name] = drawn.reshape(*x.shape[:-1], *head.shape)
    return action


def mode(heads: tuple[Head, ...], out: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
    """Returns the most likely action, as `sample` does."""
    action = {}
    for head in heads:
        x = out[head.name]
        best = _logits(head, x).argmax(-1).astype(jnp.int32) if head.bins else x.astype(jnp.float32)
        action[head.name] = best.reshape(*x.shape[:-1], *head.shape)
    return action


def log_prob(heads: tuple[Head, ...], out: Mapping[str, jax.Array], action: Mapping[str, jax.Array]) -> jax.Array:
    """Returns the log-probability (density) of an action over all its parts: (...,) float32."""
    total: jax.Array | float = 0.0
    for head in heads:
        x = out[head.name]
        value = action[head.name].reshape(*x.shape[:-1], head.n)
        if head.bins:
            picked = jnp.take_along_axis(_logits(head, x), value[..., None].astype(jnp.int32), axis=-1)
            total = total + picked[..., 0].sum(-1)
        else:
            log_std = out[f"{head.name} log std"]
            z = (value - x.astype(jnp.float32)) / jnp.exp(log_std)
            total = total - (0.5 * z * z + log_std + 0.5 * log(tau)).sum(-1)
    return jnp.asarray(total)


def entropies(heads: tuple[Head, ...], out: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
    """Returns the entropy of every part in nats, by name: (...,) float32; their sum is that of the action."""
    found = {}
    for head in heads:
        x = out[head.name]
        if head.bins:
            logs = _logits(head, x)
            found[head.name] = -(jnp.exp(logs) * logs).sum((-1, -2))
        else:
            found[head.name] = (out[f"{head.name} log std"] + 0.5 * log(tau) + 0.5).sum(-1)
    return found
