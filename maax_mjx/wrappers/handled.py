"""Parts that the mechanics of locks and grabs share: observations by kind, names of actions."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.observed import AGENT, Column, Observed
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.modules import Entities


def check_new_action(env: Environment, name: str) -> str:
    """Returns a name for an action that the environment does not have yet.

    Raises:
        ValueError: a name that is no identifier, or is taken.
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(f"action_name: got {name!r}; takes a name that is a Python identifier")
    taken = list(check_environment(env).action_space.spaces)
    if name in taken:
        raise ValueError(f"action_name: got {name!r}, which env has already; takes another than {taken}")
    return name


def by_kind(modules: Sequence[Entities], columns: Sequence[jax.Array], what: str) -> dict[str, jax.Array]:
    """Returns observations `<kind>_<what>` (n_agents, n, n_columns), one per module.

    Args:
        modules: modules of the objects, in the order of the columns' second axis.
        columns: columns (n_agents, n_objects) over all modules' objects.
        what: the end of the observations' names.
    """
    stacked = jnp.stack([jnp.asarray(column, jnp.float32) for column in columns], axis=-1)
    parts = jnp.split(stacked, np.cumsum([m.n_max for m in modules])[:-1], axis=1)
    return {f"{m.kind}_{what}": part for m, part in zip(modules, parts, strict=True) if m.n_max}


def declared_by_kind(modules: Sequence[Entities], what: str, columns: tuple[Column, ...]) -> dict[str, Observed]:
    """Returns the declarations of the observations of `by_kind`."""
    return {f"{m.kind}_{what}": Observed((AGENT, m.kind), columns) for m in modules if m.n_max}
