"""One world as a `ParallelEnv` of PettingZoo."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.adapters.agents import PerAgent
from maax_mjx.common.checks import check_choice, check_count, described
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.core.env import Environment
from maax_mjx.viewer import render


def pettingzoo(env: Environment, *, flat: bool = True, seed: int = 0) -> Any:
    """Makes a `pettingzoo.ParallelEnv` of one world.

    Agents are named as in `env.agent_names`; those who are not in play in an episode are absent from it. An episode
    ends for all of them at once. `infos` have, for every agent, "can_act": whether what it does next has an effect.

    Example:
        ```python
        env = adapters.pettingzoo(maax.make("hide_and_seek_quadrant", observations="ego"))
        observations, infos = env.reset(seed=0)
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)
        ```

    Args:
        env: an environment whose agents observe for themselves: with `SplitObservations`, as games with
            `observations="ego"`, or flat. Bins, locks and grabs are one `MultiDiscrete`, in the order of their names;
            numbers and choices together are a dict.
        flat: whether an agent observes one vector, or a dict of arrays.
        seed: of the episodes before the first `reset(seed=...)`.

    Raises:
        MissingLibraryError: without PettingZoo, the extra "pettingzoo".
        ValueError: an environment whose agents share their observations.
    """
    try:
        from pettingzoo import ParallelEnv
    except ImportError as error:
        raise MissingLibraryError(f"pettingzoo: needs PettingZoo; {brought_by('pettingzoo')}") from error

    class World(ParallelEnv):
        """A world of maax_mjx."""

        def __init__(self) -> None:
            self._of = PerAgent(env, flat)
            made = env.made_from
            self.metadata = {"name": made.name if made else type(env).__name__, "render_modes": ["rgb_array"]}
            self.render_mode = "rgb_array"
            self.possible_agents = list(env.agent_names)
            self._slots = {name: i for i, name in enumerate(self.possible_agents)}
            # Every agent has spaces of its own, since drawing from one goes on from draw to draw.
            self.observation_spaces = {name: deepcopy(self._of.observation_space) for name in self.possible_agents}
            self.action_spaces = {name: deepcopy(self._of.action_space) for name in self.possible_agents}
            self.agents: list[str] = []
            self._key = jax.random.key(check_count("seed", seed))
            self._state: Any = None

        def observation_space(self, agent: str) -> Any:
            return self.observation_spaces[check_choice("agent", agent, self.possible_agents)]

        def action_space(self, agent: str) -> Any:
            return self.action_spaces[check_choice("agent", agent, self.possible_agents)]

        def reset(self, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
            if seed is not None:
                self._key = jax.random.key(check_count("seed", seed))
            self._key, key = jax.random.split(self._key)
            self._state = self._of.env.reset(key)
            active = np.asarray(self._state.active)
            self.agents = [name for name, plays in zip(self.possible_agents, active, strict=True) if plays]
            return self._observed(), self._infos()

        def step(self, actions: dict[str, Any]) -> tuple[dict, dict, dict, dict, dict]:
            if not self.agents:
                got = "no world yet" if self._state is None else "an episode that has ended"
                raise ValueError(f"step: got {got}; takes one that reset begins")
            if not isinstance(actions, Mapping):
                raise ValueError(f"actions: got {described(actions)}; takes a dict with the action of every agent")
            if missing := [agent for agent in self.agents if agent not in actions]:
                raise ValueError(f"actions: got none of {missing}; takes one of every agent in `agents`")
            if unknown := [agent for agent in actions if agent not in self._slots]:
                raise ValueError(f"actions: got {unknown}; takes those of {self.possible_agents}")
            chosen = [
                self._of.check_one(actions[name], f"actions[{name!r}]") if name in actions else self._of.idle
                for name in self.possible_agents
            ]
            self._state = self._of.env.step(
                self._state, self._of.action(jax.tree.map(lambda *x: jnp.stack(x), *chosen))
            )
            observed, infos, reward = self._observed(), self._infos(), np.asarray(self._state.reward)
            ended, cut = bool(self._state.terminated), bool(self._state.truncated)
            here = self.agents
            rewards = {name: float(reward[self._slots[name]]) for name in here}
            if ended or cut:
                self.agents = []
            return observed, rewards, dict.fromkeys(here, ended), dict.fromkeys(here, cut), infos

        def render(self) -> np.ndarray:
            if self._state is None:
                raise ValueError("render: got no world yet; takes one that reset begins")
            return render(env, self._state)

        def close(self) -> None:
            pass

        def _observed(self) -> dict[str, Any]:
            obs = jax.tree.map(np.asarray, self._of.observations(self._state.obs))
            return {name: jax.tree.map(lambda x, i=self._slots[name]: np.array(x[i]), obs) for name in self.agents}

        def _infos(self) -> dict[str, dict[str, Any]]:
            can = np.asarray(self._state.can_act)
            return {name: {"can_act": bool(can[self._slots[name]])} for name in self.agents}

    return World()
