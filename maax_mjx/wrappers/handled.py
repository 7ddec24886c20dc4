"""What mechanics that handle objects share: observations by kind, names of actions."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.observed import AGENT, Column, Observed
from maax_mjx.core.env import Environment, check_environment
from maax_mjx.modules import Entities


def check_new_action(env: Environment, name: str) -> str:
    """A name for an action that the environment does not have.

    Raises:
        ValueError: no identifier, or one that is taken.
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ValueError(f"action_name: got {name!r}; takes a name that is a Python identifier")
    taken = list(check_environment(env).action_space.spaces)
    if name in taken:
        raise ValueError(f"action_name: got {name!r}, which env has already; takes another than {taken}")
    return name


def by_kind(modules: Sequence[Entities], columns: Sequence[jax.Array], what: str) -> dict[str, jax.Array]:
    """Observations `<kind>_<what>` (n_agents, n, n_columns) of the objects of every module.

    Args:
        modules: of the objects, in the order of the columns.
        columns: (n_agents, n_objects) each, of all modules' objects together.
        what: the end of the names.
    """
    stacked = jnp.stack([jnp.asarray(column, jnp.float32) for column in columns], axis=-1)
    parts = jnp.split(stacked, np.cumsum([m.n_max for m in modules])[:-1], axis=1)
    return {f"{m.kind}_{what}": part for m, part in zip(modules, parts, strict=True) if m.n_max}


def declared_by_kind(modules: Sequence[Entities], what: str, columns: tuple[Column, ...]) -> dict[str, Observed]:
    """What `by_kind` gives."""
    return {f"{m.kind}_{what}": Observed((AGENT, m.kind), columns) for m in modules if m.n_max}
