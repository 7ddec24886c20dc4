"""A batch as a `VecEnv` of Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from maax_mjx.adapters.gymnasium import gymnasium_vector
from maax_mjx.common.checks import check_bool
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.parallel import Worlds


def stable_baselines3(
    worlds: Worlds,
    team: str | None = None,
    policy: Any = None,
    *,
    flat: bool = True,
    seed: int = 0,
    stagger: bool = False,
) -> Any:
    """Makes a `VecEnv` of Stable-Baselines3 whose environments are the agents of a team, or all agents.

    All of them share what is learnt. Agents that are not in play in an episode observe zeros; `infos` say who
    is, as "active". On a CPU call `torch.set_num_threads(1)`: the engine `c` uses all cores.

    Example:
        ```python
        worlds = maax.Worlds(maax.make("hide_and_seek_quadrant", observations="ego"), 32)
        PPO("MlpPolicy", adapters.stable_baselines3(worlds, "seekers", "random", stagger=True)).learn(100_000)
        ```

    Args:
        worlds, team, policy, flat, seed: as for `gymnasium_vector`.
        stagger: whether `reset` spreads the ends of the first episodes, as training does best; these are shorter, and
            their returns smaller. False for `evaluate_policy`, which counts the first episodes.

    Raises:
        MissingLibraryError: without Stable-Baselines3, the extra "stable-baselines3".
        ValueError: what `gymnasium_vector` refuses, actions of numbers and choices together, or `stagger` with an
            endless game.
    """
    try:
        from stable_baselines3.common.vec_env import VecEnv
    except ImportError as error:
        raise MissingLibraryError(
            f"stable_baselines3: needs Stable-Baselines3; {brought_by('stable-baselines3')}"
        ) from error
    if check_bool("stagger", stagger) and worlds.env.base.horizon is None:
        raise ValueError("stagger: got True for a game without a horizon, whose episodes do not end; takes False")
    envs = gymnasium_vector(worlds, team, policy, flat=flat, seed=seed)
    envs.rows.of.one_kind("worlds")

    class Agents(VecEnv):
        """Agents of maax_mjx."""

        render_mode = None

        def __init__(self) -> None:
            super().__init__(envs.num_envs, _with_axes(envs.single_observation_space), envs.single_action_space)
            self._actions: Any = None

        def reset(self) -> Any:
            seeds = [seed for seed in self._seeds if seed is not None]
            self._reset_seeds()
            if any(self._options):
                raise ValueError(f"options: got {self._options}; takes none")
            return _seen(envs.reset(seed=seeds[0] if seeds else None, options={"stagger": stagger})[0], envs.num_envs)

        def step_async(self, actions: np.ndarray) -> None:
            self._actions = actions

        def step_wait(self) -> Any:
            obs, rewards, terminated, truncated, found = envs.step(self._actions)
            infos: list[dict[str, Any]] = [{"active": bool(active)} for active in found["active"]]
            for i in np.flatnonzero(terminated | truncated):
                episode = {"r": float(found["final_info"]["episode_return"][i])}
                episode |= {"l": int(found["final_info"]["episode_length"][i]), "t": 0.0}
                infos[i] |= {
                    "terminal_observation": _seen(found["final_obs"][i]),
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": episode,
                }
            return _seen(obs, envs.num_envs), rewards, terminated | truncated, infos

        def close(self) -> None:
            pass

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False for _ in self._get_indices(indices)]

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            return [getattr(self, attr_name) for _ in self._get_indices(indices)]

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            raise ValueError("set_attr: got it for agents of one batch, which have no attributes of their own")

        def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
            raise ValueError("env_method: got it for agents of one batch, which have no methods of their own")

    return Agents()


def _with_axes(space: spaces.Space) -> spaces.Space:
    """Returns the space of what an agent observes, in which numbers are vectors of one: networks take no others."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: _with_axes(part) for name, part in space.spaces.items()})
    if isinstance(space, spaces.Box) and space.shape == ():
        return spaces.Box(space.low.reshape(1), space.high.reshape(1), (1,), space.dtype.type)
    return space


def _seen(obs: Any, *lead: int) -> Any:
    """Returns observations with the leading axes `lead` in the space of `_with_axes`."""
    if isinstance(obs, dict):
        return {name: _seen(x, *lead) for name, x in obs.items()}
    return np.reshape(obs, (*lead, 1)) if np.shape(obs) == lead else obs
