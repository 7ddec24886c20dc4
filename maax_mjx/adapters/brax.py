"""One team of a game as an environment of Brax's."""

from __future__ import annotations

from typing import Any

from maax_mjx.adapters.team import OneTeam
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.core.env import Environment


def brax(env: Environment, team: str | None = None, policy: Any = None) -> Any:
    """Makes a `brax.envs.base.Env` of one team of a game, as one agent with vectors of numbers.

    It observes the vectors of its agents, one after the other, and decides a number in [-1, 1] for everything that one
    of them decides: forces as they are, bins by the nearest, choices of two by the sign. Its reward is the mean of its
    agents in play. Give Brax's wrapper and trainers `episode_length=env.base.horizon`: the horizon is theirs to keep.
    Brax begins every episode of a world in the same layout, that of the world's first reset.

    Example:
        ```python
        from brax.envs.wrappers.training import wrap

        batch = wrap(adapters.brax(env, "seekers", policy="random"), episode_length=env.base.horizon)
        state = jax.jit(batch.reset)(jax.random.split(jax.random.PRNGKey(0), 8))
        state = jax.jit(batch.step)(state, jnp.zeros((8, batch.action_size)))
        ```

    Args:
        env: an environment whose agents observe for themselves.
        team: name of the team; None is all agents.
        policy: who plays the others; see `gymnasium_vector`.

    Raises:
        MissingLibraryError: without Brax, the extra "brax".
        ValueError: see `gymnasium_vector`.
    """
    try:
        from brax.envs.base import Env
        from brax.envs.base import State as BraxState
    except ImportError as error:
        raise MissingLibraryError(f"brax: needs Brax; {brought_by('brax')}") from error
    of = OneTeam(env, team, policy)

    class Game(of.as_env(Env, BraxState, "pipeline_state")):  # type: ignore[misc]
        """One team of a game of maax_mjx."""

        @property
        def backend(self) -> str:
            return of.env.base.engine.impl

        @property
        def dt(self) -> float:
            return of.env.base.dt

    return Game()
