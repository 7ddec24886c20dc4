"""Curricula: worlds grow harder with success (thesis 3.3; Rudin et al. 2022, game-inspired curriculum).

Every world has a level. After an episode it goes up a level if it was a success, and down if it was a failure. A world
that succeeds at the last level goes on at a random one, so that no level is forgotten.

Example:
    curriculum = Curriculum([env.default_params.replace(n_boxes=n) for n in (1, 2, 4)])
    levels = curriculum.start(worlds.n_worlds)
    states = worlds.reset(key, curriculum.params(levels))
    ...
    states = worlds.step(states, action)
    levels = curriculum.update(key, levels, states.done, success=states.episode_return[:, 0] > 10)
    states = worlds.with_params(states, curriculum.params(levels))
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from maax_mjx.params import DomainParams


class Curriculum:
    """Levels of difficulty, each a set of ranges. Methods are pure and may be jitted.

    Since the next episode of a world is drawn ahead of time, a new level holds from the next reset on.

    Args:
        levels: from the easiest to the hardest, of the same environment.

    Raises:
        ValueError: no levels, or levels of different environments.
    """

    def __init__(self, levels: Sequence[DomainParams]):
        if not levels or not all(isinstance(level, DomainParams) for level in levels):
            raise ValueError(f"levels: got {levels!r}; takes one or more DomainParams")
        if len({tuple(sorted(level)) for level in levels}) > 1:
            raise ValueError(f"levels: got ranges for {[sorted(level) for level in levels]}; takes the same for all")
        self._levels = jax.tree.map(lambda *x: jnp.stack(x), *levels)
        self.n_levels = len(levels)

    def start(self, n_worlds: int, level: int = 0) -> jax.Array:
        """(n_worlds,) int32: every world at `level`."""
        return jnp.full(n_worlds, level, jnp.int32)

    def params(self, levels: jax.Array) -> DomainParams:
        """The ranges of every world, leaves (n_worlds, 2), for `levels` (n_worlds,)."""
        return jax.tree.map(lambda x: x[levels], self._levels)

    def update(self, key: jax.Array, levels: jax.Array, done: jax.Array, success: jax.Array) -> jax.Array:
        """The levels after a step.

        Args:
            key: for worlds beyond the last level.
            levels: (n_worlds,) int32.
            done: (n_worlds,) bool, whose episode has just ended; others stay.
            success: (n_worlds,) bool, how it ended.

        Returns:
            (n_worlds,) int32.
        """
        moved = levels + jnp.where(success, 1, -1)
        anywhere = jax.random.randint(key, levels.shape, 0, self.n_levels)
        moved = jnp.where(moved >= self.n_levels, anywhere, jnp.maximum(moved, 0))
        return jnp.where(done, moved, levels)
