"""The registry of environments by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from types import ModuleType
from typing import Any, NamedTuple

import jax

from maax_mjx.common.annotated import check_fields
from maax_mjx.common.checks import check_choice, check_new_name, check_takes, is_traced
from maax_mjx.common.params import DomainParams
from maax_mjx.common.runtime import no_collection
from maax_mjx.core.env import Environment, Made
from maax_mjx.core.state import State
from maax_mjx.tasks.brought import GROUP, TAKES, config_class, games_in, installed, is_in_a_file, module_of, short_name
from maax_mjx.tasks.config import Extensions, override


class Task(NamedTuple):
    """A registered environment: the function that builds it, and the class of its config."""

    build: Callable[[Any], Environment]
    config: type


_TASKS: dict[str, Task] = {}


def tasks() -> list[str]:
    """Returns the names that `make` takes, those of installed packages among them; see `check_game` for others."""
    return sorted({*(name for name in _TASKS if not is_in_a_file(name)), *installed()})


def check_game(argument: str, name: Any) -> str:
    """Returns the name of a game: one of `tasks()`, or one in a file, "my_game.py:football".

    Raises:
        ValueError: another name; the message suggests the nearest ones.
    """
    if isinstance(name, str) and name.endswith(".py"):
        raise ValueError(f"{argument}: got {name!r}, a file without the name of a game; {TAKES}")
    if is_in_a_file(name):
        return name
    if isinstance(name, str) and "/" in name:
        raise ValueError(
            f"{argument}: got {name!r}; takes a name of {tasks()}, or a game in a file, my_game.py:football"
        )
    return check_choice(argument, name, tasks())


def _task(name: str) -> Task:
    """Returns a game's builder and config class; files and packages are imported when they are asked for first."""
    # First: what other packages bring is looked for in the metadata of everything that is installed.
    if isinstance(name, str) and name in _TASKS:
        return _TASKS[name]
    if is_in_a_file(check_game("name", name)):
        _bring_from_file(name)
    else:
        _bring_from_package(name)
    return _TASKS[name]


def _bring_from_file(name: str) -> None:
    before = dict(_TASKS)
    try:
        module = module_of(name)
    except BaseException:
        # So that a file that was mended registers its games anew.
        _TASKS.clear()
        _TASKS.update(before)
        raise
    registered = {key: task for key, task in _TASKS.items() if not is_in_a_file(key)}
    own = {key: task for key, task in registered.items() if key not in before or _is_of(task, module)}
    found = own | {key: Task(*game) for key, game in games_in(module).items() if key not in own}
    if (short := short_name(name)) not in found:
        if callable(getattr(module, short, None)):
            raise ValueError(
                f"name: got {name!r}, and {short} does not say which config it takes; takes a function of one argument "
                "that is annotated with a dataclass, or one that the file registers with maax.register(...)"
            )
        raise ValueError(f"name: got {name!r}, whose file has the games {sorted(found)}; {TAKES}")
    register(name, *found[short])


def _is_of(task: Task, module: ModuleType) -> bool:
    return getattr(task.build, "__module__", None) == module.__name__


def _bring_from_package(name: str) -> None:
    point = installed()[name]
    try:
        build = point.load()
    except Exception as error:
        raise ValueError(
            f"name: got {name!r}, whose package cannot be imported ({type(error).__name__}: {error}); takes one of "
            f"{sorted(_TASKS)}"
        ) from error
    # The import may have registered it.
    if name not in _TASKS:
        config = config_class(build)
        if config is None:
            raise ValueError(
                f"name: got {name!r}, whose entry point in {GROUP!r}, {point.value}, is {build!r}; takes a function "
                "whose only argument is annotated with a frozen dataclass"
            )
        register(name, build, config)


def register(name: str, build: Callable[[Any], Environment], config: type) -> None:
    """Registers an environment under a name: your own modules and wrappers, packaged as a game.

    Args:
        name: a new name without spaces, or the one that a function of the same name and module has, which this one
            replaces.
        build: function that makes the environment from a config.
        config: a frozen dataclass whose fields all have defaults, which `make` can override; their values are held
            against the annotations.

    Raises:
        ValueError: a name that is taken, a function that takes other arguments, a config that is not such a class, or
            defaults that its annotations do not allow.
    """
    check_new_name(name, {taken: task.build for taken, task in _TASKS.items()}, build)
    if name.split() != [name]:
        raise ValueError(f"name: got {name!r}; takes a name without spaces, which command lines take as it is")
    if not callable(build):
        raise ValueError(f"build: got {build!r}; takes a function from a config to an environment")
    check_takes("build", build, ("config",), "environment")
    if not isinstance(config, type) or not is_dataclass(config) or not config.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise ValueError(f"config: got {config!r}; takes a class made by dataclass(frozen=True)")
    try:
        defaults = config()
    except TypeError as error:
        raise ValueError(
            f"config: got {config.__name__}, with fields without defaults ({error}); takes one without"
        ) from None
    check_fields(defaults)
    _TASKS[name] = Task(build, config)


def config_of(name: str | Environment, **overrides: Any) -> Any:
    """Returns the config of a named environment, or the one that an environment was made from.

    Args:
        name: a name that `make` takes, or an environment that `make` made, with or without further wrappers.
        **overrides: fields to change; see `make`.

    Raises:
        ValueError: an unknown name or field (the message suggests the nearest ones), or an environment that `make` did
            not make.
    """
    if isinstance(name, Environment):
        made = name.made_from
        if made is None:
            raise ValueError(f"config_of: got {name!r}, which has no config; takes what maax.make made, or its name")
        return override(made.config, overrides, f"config_of({made.name!r})")
    task = _task(name)
    return override(task.config(), overrides, f"make({name!r})")


def make(name: str, config: Any = None, **overrides: Any) -> Environment:
    """Builds an environment by name.

    Example:
        ```python
        env = make("hide_and_seek", n_boxes=(1, 4), **{"lock.radius": 0.3})
        env = make("hide_and_seek_quadrant", modules=[Door()], inside={"HideAndSeekReward": Flashlight})
        ```

    Args:
        name: one of `tasks()`, or a game in a file of one's own, "my_game.py:football": what the file registers under
            that name, or a function whose only argument is annotated with a frozen dataclass.
        config: an object of the environment's config class to start from; None uses the defaults.
        **overrides: values by field of that config, or by dotted name for fields of fields. Games have the fields
            `modules`, `inside` and `outside`, for what is put in between; see `extended`.

    Raises:
        ValueError: an unknown name or field (the message suggests the nearest ones), a config of another class, or a
            config that the environment refuses.
    """
    defaults = config_of(name)
    if config is not None and not isinstance(config, type(defaults)):
        got = f"the class {config.__name__}" if isinstance(config, type) else type(config).__name__
        raise ValueError(
            f"config: got {got}; takes a {type(defaults).__name__} for {name!r}, or fields by name: "
            f"make({name!r}, {fields(defaults)[0].name}=...)"
        )
    config = override(defaults if config is None else config, overrides, f"make({name!r})")
    check_fields(config)
    with no_collection():
        env = _task(name).build(config)
    if not isinstance(env, Environment):
        raise ValueError(f"build: got {env!r} from that of {name!r}; takes a function from a config to an environment")
    if isinstance(config, Extensions):
        env = config.extend(env)
    env.made = Made(make, name, config)
    return env


def jitted(env: Environment | str, **overrides: Any) -> tuple[Callable[..., State], Callable[..., State]]:
    """Compiles an environment's two functions, at their first call.

    They check their arguments before compiled code takes over, and may be vmapped, scanned and jitted again.

    Args:
        env: an environment, or the name of one.
        **overrides: as for `make`; only with a name.

    Returns:
        `reset(key, params=None)` and `step(state, action)`.
    """
    if isinstance(env, str):
        env = make(env, **overrides)
    elif not isinstance(env, Environment):
        raise ValueError(f"env: got {env!r}; takes an environment or one of {tasks()}")
    elif overrides:
        raise ValueError(f"overrides: got {sorted(overrides)} with an environment; takes them only with a name")
    fast_reset, fast_step = jax.jit(env.reset), jax.jit(env.step)

    def reset(key: jax.Array, params: DomainParams | None = None) -> State:
        return (fast_reset if is_traced((key, params)) else env.reset)(key, params)

    def step(state: State, action: dict[str, jax.Array]) -> State:
        return (fast_step if is_traced((state, action)) else env.step)(state, action)

    return reset, step
