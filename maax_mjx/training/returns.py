"""Advantages, and the scale of what critics predict."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

DECAY = 0.99
"""Share of the running moments that stays at every iteration."""
LEAST_VARIANCE = 1e-2


def advantages(
    reward: jax.Array,
    value: jax.Array,
    after: jax.Array,
    end: jax.Array,
    last: jax.Array,
    fault: jax.Array,
    gamma: float,
    lam: float,
) -> jax.Array:
    """Generalised advantage estimates (Schulman et al. 2016).

    A step with a physics fault neither pays nor costs: its advantage is zero, and the step before bootstraps from the
    value of the state in which the fault happened.

    Args:
        reward: (n_steps, ...) reward of every step.
        value: (n_steps, ...) value of the state before the step.
        after: (n_steps, ...) value of the state after it, of the same episode; not used where `end`.
        end: (n_steps, ...) bool, whether the game was over, so that nothing is worth anything after the step.
        last: (n_steps, ...) bool, whether it was the episode's last step, over or cut off.
        fault: (n_steps, ...) bool, whether the step was rolled back.
        gamma: discount.
        lam: weight of longer estimates.

    Returns:
        (n_steps, ...) float32.
    """

    def back(later: jax.Array, t: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        reward, value, after, end, fault, last = t
        going = jnp.where(end, 0.0, gamma)
        here = reward + going * after - value + jnp.where(last, 0.0, gamma * lam) * later
        here = jnp.where(fault, 0.0, here)
        return here, here

    steps = (reward, value, after, end, fault, last)
    return jax.lax.scan(back, jnp.zeros_like(value[0]), steps, reverse=True)[1]


class ValueScale(struct.PyTreeNode):
    """Running mean and variance of the targets of critics, which predict in their units (MAPPO's ValueNorm).

    Attributes:
        mean, square: () moments, not yet divided by `weight`.
        weight: () what they have seen, from 0 up to 1.
    """

    mean: jax.Array
    square: jax.Array
    weight: jax.Array

    @classmethod
    def new(cls) -> ValueScale:
        """A scale that has seen nothing: values are their own units."""
        return cls(*(jnp.zeros(()) for _ in range(3)))

    @property
    def moments(self) -> tuple[jax.Array, jax.Array]:
        """The mean and the standard deviation."""
        weight = jnp.maximum(self.weight, 1e-8)
        mean = self.mean / weight
        std = jnp.sqrt(jnp.maximum(self.square / weight - mean * mean, LEAST_VARIANCE))
        return jnp.where(self.weight > 0, mean, 0.0), jnp.where(self.weight > 0, std, 1.0)

    def updated(self, mean: jax.Array, square: jax.Array) -> ValueScale:
        """Returns the scale after targets with a mean and a mean square."""
        return ValueScale(
            DECAY * self.mean + (1 - DECAY) * mean,
            DECAY * self.square + (1 - DECAY) * square,
            DECAY * self.weight + (1 - DECAY),
        )

    def denormalised(self, x: jax.Array) -> jax.Array:
        """Returns predictions in the units of rewards."""
        mean, std = self.moments
        return mean + std * x

    def normalised(self, x: jax.Array) -> jax.Array:
        """Returns returns in the units of predictions."""
        mean, std = self.moments
        return (x - mean) / std
