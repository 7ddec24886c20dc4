"""Sums over the episodes that ended in a rollout."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np


class Ended(NamedTuple):
    """Sums over episodes that ended.

    Attributes:
        episodes: () how many.
        steps: () the steps that were played of them.
        returns: (n_agents,) reward of the episodes in which an agent played.
        played: (n_agents,) how many these are.
    """

    episodes: jax.Array | np.ndarray
    steps: jax.Array | np.ndarray
    returns: jax.Array | np.ndarray
    played: jax.Array | np.ndarray

    @classmethod
    def none(cls, n_agents: int) -> Ended:
        """The sums before the first episode ends."""
        return cls(np.zeros(()), np.zeros(()), np.zeros(n_agents), np.zeros(n_agents))

    @classmethod
    def of(cls, done: jax.Array, active: jax.Array, episode_return: jax.Array, episode_length: jax.Array) -> Ended:
        """The sums of some steps.

        Args:
            done: (..., n_worlds) bool, whether an episode ended.
            active: (..., n_worlds, n_agents) bool, which agents played in it: as they were before the step, after which
                a new episode has begun.
            episode_return: (..., n_worlds, n_agents).
            episode_length: (..., n_worlds).
        """
        mine = done[..., None] & active
        worlds = tuple(range(done.ndim))
        return cls(
            done.sum(),
            jnp.where(done, episode_length, 0).sum(),
            jnp.where(mine, episode_return, 0.0).sum(worlds),
            mine.sum(worlds),
        )

    def plus(self, other: Ended) -> Ended:
        """The sums of both, on the host and in 64 bits, in which long rollouts count exactly."""
        return Ended(*(np.asarray(a, float) + np.asarray(b, float) for a, b in zip(self, other, strict=True)))

    def mean_return(self, names: Sequence[str]) -> dict[str, float] | None:
        """The mean return of each agent that played in any of them; None where none ended.

        Args:
            names: of the agents.
        """
        if not self.episodes:
            return None
        rows = zip(names, self.returns, self.played, strict=True)
        return {name: round(float(total / n), 2) for name, total, n in rows if n}

    @property
    def mean_length(self) -> float | None:
        """How many steps were played of an episode, in the mean; None where none ended."""
        return round(float(self.steps / self.episodes), 1) if self.episodes else None
