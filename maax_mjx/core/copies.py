"""Pickles and deep copies of environments, with a sentence where something in them cannot be copied."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any, TypeVar

from maax_mjx.common.checks import described
from maax_mjx.modules.from_model import without_cached

E = TypeVar("E")


def reduced(env: object, make: Callable[..., Any], *args: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Returns what pickle writes of an environment: the function that makes it again, and its arguments.

    Raises:
        ValueError: arguments that cannot be pickled.
    """
    how = make, args
    try:
        pickle.dumps(how)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"env: got {env!r}, which cannot be pickled ({error}); takes functions and classes that have names in "
            "modules, instead of lambdas and those defined inside of functions"
        ) from error
    return how


def copied(env: E, memo: dict[int, Any]) -> E:
    """Copies an environment and what it wraps, without what was computed from its model.

    Raises:
        ValueError: an attribute that cannot be copied.
    """
    twin = object.__new__(type(env))
    memo[id(env)] = twin
    for name, value in without_cached(env).items():
        try:
            twin.__dict__[name] = copy.deepcopy(value, memo)
        except (TypeError, copy.Error) as error:
            mine = type(env).__name__
            raise ValueError(
                f"env: {mine}.{name} is {described(value)}, which cannot be copied ({error}); keep it outside of "
                f"the environment, or give {mine} a __deepcopy__"
            ) from error
    return twin
