"""An environment as JaxMARL's `MultiAgentEnv`."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
from gymnasium import spaces

from maax_mjx.adapters.agents import PerAgent, choices_of
from maax_mjx.common.checks import check_choice, described, is_traced
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.common.keys import new_key
from maax_mjx.core.env import Environment

MOST = 10_000
"""Actions that an agent may choose among."""


def jaxmarl(env: Environment) -> Any:
    """Makes a `jaxmarl.environments.multi_agent_env.MultiAgentEnv`.

    Agents are named as in `env.agent_names`, and observe one vector each. JaxMARL's scripts know a box of numbers, or
    one number of choices: bins, locks and grabs are numbered together, the last one changing fastest, which suits games
    of few bins (`DiscretizeActions(env, 3)`). Agents that are not in play observe zeros. JaxMARL does not tell
    truncation from termination, and draws a new world at every step, used or not: `Worlds` is faster.

    Example:
        ```python
        jaxmarl.make = lambda name, **fields: adapters.jaxmarl(maax.make(name, **fields))  # then run one of its scripts
        ```

    Args:
        env: an environment whose agents observe for themselves.

    Raises:
        MissingLibraryError: without JaxMARL, the extra "jaxmarl".
        ValueError: agents who share their observations, who decide numbers and choices together, or who have too many
            choices.
    """
    try:
        from jaxmarl.environments import spaces as theirs
        from jaxmarl.environments.multi_agent_env import MultiAgentEnv
    except ImportError as error:
        raise MissingLibraryError(f"jaxmarl: needs JaxMARL; {brought_by('jaxmarl')}") from error
    of = PerAgent(env)
    space = of.one_kind("env")
    choices = choices_of(space)
    if choices is not None and prod(choices) > MOST:
        raise ValueError(
            f"env: got {env!r}, whose agents have {prod(choices):,} choices; takes up to {MOST:,}, by fewer bins"
        )

    class Game(MultiAgentEnv):
        """A game of maax_mjx."""

        def __init__(self) -> None:
            super().__init__(env.n_agents)
            self.env = of.env
            self.agents = list(env.agent_names)
            sees = theirs.Box(-jnp.inf, jnp.inf, of.observation_space.shape)
            if choices is None:
                assert isinstance(space, spaces.Box)
                does = theirs.Box(float(space.low.min()), float(space.high.max()), space.shape)
            else:
                does = theirs.Discrete(prod(choices))
            self.observation_spaces = dict.fromkeys(self.agents, sees)
            self.action_spaces = dict.fromkeys(self.agents, does)

        @property
        def name(self) -> str:
            made = env.made_from
            return made.name if made else type(env).__name__

        def observation_space(self, agent: str) -> Any:
            return self.observation_spaces[check_choice("agent", agent, self.agents)]

        def action_space(self, agent: str) -> Any:
            return self.action_spaces[check_choice("agent", agent, self.agents)]

        def reset(self, key: jax.Array) -> tuple[dict[str, jax.Array], Any]:
            state = self.env.reset(new_key(key))  # keys are of the old kind there
            return self.get_obs(state), state

        def step(
            self, key: jax.Array, state: Any, actions: dict[str, jax.Array], reset_state: Any = None
        ) -> tuple[dict[str, jax.Array], Any, dict[str, jax.Array], dict[str, jax.Array], dict[str, Any]]:
            _, after, rewards, dones, infos = self.step_env(key, state, actions)
            begun = self.reset(key)[1] if reset_state is None else reset_state
            state = jax.tree.map(lambda new, old: jnp.where(dones["__all__"], new, old), begun, after)
            return self.get_obs(state), state, rewards, dones, infos

        def step_env(
            self, key: jax.Array, state: Any, actions: dict[str, jax.Array]
        ) -> tuple[dict[str, jax.Array], Any, dict[str, jax.Array], dict[str, jax.Array], dict[str, Any]]:
            after = self.env.step(state, of.action(self._chosen(actions)))
            dones = dict.fromkeys([*self.agents, "__all__"], after.done)
            return self.get_obs(after), after, self._split(after.reward), dones, {}

        def _chosen(self, actions: Mapping[str, jax.Array]) -> jax.Array:
            """Returns the actions of all agents, (n_agents, ...), as their space has them."""
            if not isinstance(actions, Mapping):
                raise ValueError(f"actions: got {described(actions)}; takes a dict with one of each of {self.agents}")
            if set(actions) != set(self.agents):
                raise ValueError(f"actions: got those of {sorted(actions)}; takes one of each of {self.agents}")
            each = {agent: jnp.asarray(actions[agent]) for agent in self.agents}
            shape = (space.shape or ()) if choices is None else ()
            for agent, action in each.items():
                if action.shape != shape:
                    raise ValueError(f"actions: got shape {action.shape} of {agent}; takes {shape}")
            chosen = jnp.stack([*each.values()])
            if choices is None:
                return chosen
            most = prod(choices) - 1
            if not jnp.issubdtype(chosen.dtype, jnp.integer):
                raise ValueError(f"actions: got {chosen.dtype}; takes whole numbers from 0 to {most}")
            if not is_traced(chosen) and ((chosen < 0) | (chosen > most)).any():
                raise ValueError(f"actions: got {chosen.tolist()}; takes whole numbers from 0 to {most}")
            parts = jnp.unravel_index(chosen.reshape(-1).astype(jnp.int32), tuple(choices))
            return jnp.stack(parts, axis=-1).reshape(-1, *space.shape)  # type: ignore[misc]

        def get_obs(self, state: Any) -> dict[str, jax.Array]:
            return self._split(of.observations(state.obs))

        def _split(self, per_agent: jax.Array) -> dict[str, jax.Array]:
            return dict(zip(self.agents, per_agent, strict=True))

    return Game()
