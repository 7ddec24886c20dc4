"""Environments by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any, NamedTuple

import jax

from maax_mjx.common.checks import check_choice, check_key, check_new_name
from maax_mjx.common.params import DomainParams
from maax_mjx.common.spaces import check_action
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.tasks.config import override


class Task(NamedTuple):
    """How an environment is built, and the class of what it is built from."""

    build: Callable[[Any], Environment]
    config: type


_TASKS: dict[str, Task] = {}


def tasks() -> list[str]:
    """The names that `make` takes."""
    return sorted(_TASKS)


def register(name: str, build: Callable[[Any], Environment], config: type) -> None:
    """Gives an environment a name: modules and wrappers of your own, packaged as a game.

    Args:
        name: a new one.
        build: makes the environment from a config.
        config: a frozen dataclass whose fields all have defaults: what `make` can override.

    Raises:
        ValueError: a name that is taken, or a config that is not such a class.
    """
    check_new_name(name, _TASKS)
    if not callable(build):
        raise ValueError(f"build: got {build!r}; takes a function from a config to an environment")
    if not isinstance(config, type) or not is_dataclass(config) or not config.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise ValueError(f"config: got {config!r}; takes a class made by dataclass(frozen=True)")
    try:
        config()
    except TypeError as error:
        raise ValueError(
            f"config: {config.__name__} has fields without defaults ({error}); takes one without"
        ) from None
    _TASKS[name] = Task(build, config)


def config_of(name: str, **overrides: Any) -> Any:
    """The config of an environment by name, with some fields changed; see `make`.

    Raises:
        ValueError: an unknown name or field, with the nearest ones.
    """
    task = _TASKS[check_choice("name", name, _TASKS)]
    return override(task.config(), overrides, f"make({name!r})")


def make(name: str, config: Any = None, **overrides: Any) -> Environment:
    """Builds an environment by name.

    Example:
        env = make("hide_and_seek", n_boxes=(1, 4), **{"lock.radius": 0.3})

    Args:
        name: one of `tasks()`.
        config: what to start from, an object of the environment's config class; None is its defaults.
        **overrides: fields of that config, in dotted names for fields of fields.

    Raises:
        ValueError: an unknown name or field, with the nearest ones; a config of another class; or what the environment
            refuses.
    """
    defaults = config_of(name)
    if config is not None and not isinstance(config, type(defaults)):
        got = f"the class {config.__name__}" if isinstance(config, type) else type(config).__name__
        raise ValueError(f"config: got {got}; takes a {type(defaults).__name__} for {name!r}")
    env = _TASKS[name].build(override(defaults if config is None else config, overrides, f"make({name!r})"))
    if not isinstance(env, Environment):
        raise ValueError(f"build: that of {name!r} gave {env!r}; takes a function from a config to an environment")
    return env


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
