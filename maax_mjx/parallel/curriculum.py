"""Curricula that make worlds harder with success (thesis 3.3; Rudin et al. 2022, game-inspired curriculum).

Every world has a level. After an episode it goes up a level on success, and down on failure. A world that succeeds at
the last level continues at a random one, so that no level is forgotten.

Example:
    ```python
    curriculum = Curriculum([env.default_params.replace(n_boxes=n) for n in (1, 2, 4)])
    levels = curriculum.start(worlds.n_worlds)
    states = worlds.reset(key, curriculum.params(levels))
    ...
    states = worlds.step(states, action)
    levels = curriculum.update(key, levels, states.done, success=states.episode_return[:, 0] > 10)
    states = worlds.with_params(states, curriculum.params(levels))
    ```
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.params import DomainParams


class Levels(struct.PyTreeNode):
    """The levels of a batch's worlds.

    Attributes:
        playing: (n_worlds,) int32, levels of the running episodes.
        upcoming: (n_worlds,) int32, levels of the next episodes.
    """

    playing: jax.Array
    upcoming: jax.Array


class Curriculum:
    """Levels of difficulty, each a set of ranges. Methods are pure and may be jitted.

    When an episode ends, the next has already begun: the outcome moves the level of the one after that.

    Args:
        levels: ranges from the easiest to the hardest, of the same environment.

    Raises:
        ValueError: no levels, or levels of different environments.
    """

    def __init__(self, levels: Sequence[DomainParams]):
        levels = list(levels) if isinstance(levels, Sequence) else [levels]
        if not levels or not all(isinstance(level, DomainParams) for level in levels):
            raise ValueError(f"levels: got {levels!r}; takes one or more DomainParams")
        if len({tuple(sorted(level)) for level in levels}) > 1:
            raise ValueError(f"levels: got ranges for {[sorted(level) for level in levels]}; takes the same for all")
        shapes = {jnp.shape(x) for level in levels for x in jax.tree.leaves(level)}
        if shapes - {(2,)}:
            raise ValueError(f"levels: got ranges of shapes {sorted(shapes)}; takes (2,), the same for all worlds")
        self._levels = jax.tree.map(lambda *x: jnp.stack(x), *levels)
        self.n_levels = len(levels)

    def start(self, n_worlds: int, level: int = 0) -> Levels:
        """Puts every world at `level`.

        Raises:
            ValueError: an unknown level.
        """
        if not 0 <= level < self.n_levels:
            raise ValueError(f"level: got {level!r}; takes 0 to {self.n_levels - 1}")
        levels = jnp.full(n_worlds, level, jnp.int32)
        return Levels(playing=levels, upcoming=levels)

    def params(self, levels: Levels) -> DomainParams:
        """Returns the ranges of every world's next episode, with leaves (n_worlds, 2)."""
        return jax.tree.map(lambda x: x[levels.upcoming], self._levels)

    def update(self, key: jax.Array, levels: Levels, done: jax.Array, success: jax.Array) -> Levels:
        """Returns the levels after a step.

        Args:
            key: key of the draws for worlds that pass the last level.
            levels: levels from `start` or `update`.
            done: (n_worlds,) bool, whether an episode has just ended; the other worlds keep their levels.
            success: (n_worlds,) bool, whether it was a success.
        """
        moved = levels.playing + jnp.where(success, 1, -1)
        anywhere = jax.random.randint(key, moved.shape, 0, self.n_levels)
        moved = jnp.where(moved >= self.n_levels, anywhere, jnp.maximum(moved, 0))
        return Levels(
            playing=jnp.where(done, levels.upcoming, levels.playing),
            upcoming=jnp.where(done, moved, levels.upcoming),
        )
