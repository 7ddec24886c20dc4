"""A batch as a `VectorEnv` of Gymnasium: every agent of a team is an environment."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from maax_mjx.adapters.agents import arrays_of
from maax_mjx.adapters.rows import Rows, Step
from maax_mjx.parallel import Worlds


class AgentsVectorEnv(VectorEnv):
    """Agents of a batch as the environments of a `gymnasium.vector.VectorEnv`; `gymnasium_vector` makes it.

    Where an episode ends the next one begins in the same step: `infos` have, at its end, "final_obs" with what was
    observed last, and "final_info" with "episode_return", "episode_length", and "active", whether the agent was in
    play. Everywhere they have "active", whether it is in play now, in the new episode: those who are not observe zeros.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, rows: Rows):
        self.rows = rows
        self.num_envs = rows.n_rows
        self.single_observation_space = rows.of.observation_space
        self.single_action_space = rows.of.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draws all worlds.

        Args:
            seed: None goes on from the last draw.
            options: {"stagger": True} spreads the ends of the first episodes.

        Raises:
            ValueError: other options.
        """
        chosen = dict(options or {})
        stagger = chosen.pop("stagger", False)
        if chosen:
            raise ValueError(f"options: got {sorted(chosen)}; takes 'stagger'")
        now = self.rows.reset(seed, stagger)
        return _host(now.obs), {"active": np.array(now.active)}

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Steps all worlds.

        Args:
            actions: of all agents, as `action_space` has them.

        Raises:
            ValueError: actions of another shape.
        """
        now = self.rows.step(jax.tree.map(jnp.asarray, arrays_of(actions, "actions")))
        terminated, truncated = np.array(now.terminated), np.array(now.truncated)
        infos: dict[str, Any] = {"active": np.array(now.active)}
        if (done := terminated | truncated).any():
            infos |= _ended(now, done)
        return _host(now.obs), np.array(now.reward), terminated, truncated, infos


def gymnasium_vector(
    worlds: Worlds, team: str | None = None, policy: Any = None, *, flat: bool = True, seed: int = 0
) -> AgentsVectorEnv:
    """Makes a `gymnasium.vector.VectorEnv` of a batch, whose environments are the agents of a team, or all agents.

    Example:
        ```python
        worlds = maax.Worlds(maax.make("hide_and_seek_quadrant", observations="ego"), 64)
        envs = adapters.gymnasium_vector(worlds, team="seekers", policy="random")
        obs, infos = envs.reset(seed=0)
        obs, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
        ```

    Args:
        worlds: the batch; its environment's agents observe for themselves: with `SplitObservations`, as games with
            `observations="ego"`, or flat.
        team: name of the team; None is all agents.
        policy: who plays the others: a `training.Policy`, a file, the folder of a run, the name of one that comes with
            the package, or a scripted one such as "random" and "chase".
        flat: whether an agent observes one vector, or a dict of arrays.
        seed: of the worlds before the first `reset(seed=...)`.

    Raises:
        ValueError: an unknown team, a policy that does not fit, or agents who share their observations.
    """
    return AgentsVectorEnv(Rows(worlds, team, policy, flat, seed))


def _host(tree: Any) -> Any:
    return jax.tree.map(np.array, tree)


def _ended(now: Step, done: np.ndarray) -> dict[str, Any]:
    """Returns what Gymnasium wants to know of episodes that have ended: objects by environment, and where they are."""
    final = _host(now.final_obs)
    last = np.empty(len(done), object)
    for i in np.flatnonzero(done):
        last[i] = jax.tree.map(lambda x, i=i: x[i], final)
    info = {"episode_return": np.array(now.episode_return), "episode_length": np.array(now.episode_length)}
    info["active"] = np.array(now.played)
    info |= {f"_{name}": done for name in info}
    return {"final_obs": last, "_final_obs": done, "final_info": info, "_final_info": done}
