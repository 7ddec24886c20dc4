"""Environments by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import jax

from maax_mjx.checks import check_choice, check_key
from maax_mjx.env import Environment
from maax_mjx.params import DomainParams
from maax_mjx.spaces import check_action
from maax_mjx.state import State
from maax_mjx.tasks.standard import standard

_TASKS: dict[str, Callable[..., Environment]] = {"standard": standard}


def tasks() -> list[str]:
    """The names that `make` takes."""
    return sorted(_TASKS)


def make(name: str, **overrides: Any) -> Environment:
    """Builds an environment by name.

    Args:
        name: one of `tasks()`.
        **overrides: arguments of that task's function.

    Raises:
        ValueError: an unknown task or argument, with the nearest names; or what the task refuses.
    """
    task = _TASKS[check_choice("name", name, _TASKS)]
    for argument in overrides:
        check_choice(f"make({name!r})", argument, inspect.signature(task).parameters)
    return task(**overrides)


def jitted(env: Environment | str, **overrides: Any) -> tuple[Callable[..., State], Callable[..., State]]:
    """The two functions of an environment, compiled at their first call.

    They check their arguments before compiled code takes over, and may be vmapped, scanned and jitted again.

    Args:
        env: an environment, or the name of one.
        **overrides: as for `make`, with a name.

    Returns:
        `reset(key, params=None)` and `step(state, action)`.
    """
    if isinstance(env, str):
        env = make(env, **overrides)
    elif not isinstance(env, Environment):
        raise ValueError(f"env: got {env!r}; takes an environment or one of {tasks()}")
    elif overrides:
        raise ValueError(f"overrides: got {sorted(overrides)} beside an environment; takes them only with a name")
    fast_reset, fast_step = jax.jit(env.reset), jax.jit(env.step)

    def reset(key: jax.Array, params: DomainParams | None = None) -> State:
        check_key("key", key)
        params = env.default_params if params is None else params
        env.base.check_params(params)
        return fast_reset(key, params)

    def step(state: State, action: dict[str, jax.Array]) -> State:
        check_action(env.action_space, action)
        return fast_step(state, action)

    return reset, step
