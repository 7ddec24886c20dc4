"""`make`: environments by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from maax_mjx.checks import check_choice
from maax_mjx.env import Environment
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
