"""Observations per agent: of itself, of others, of objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.observed import AGENT, Observed, check_shapes, declaration
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.food import EatFood
from maax_mjx.wrappers.grabs import GrabObjects
from maax_mjx.wrappers.locks import LockObjects
from maax_mjx.wrappers.senses import Lidar, LineOfSight
from maax_mjx.wrappers.wrapper import ObservationWrapper

OTHER = "other"
"""Name of the axis of the other agents."""


class SplitObservations(ObservationWrapper):
    """Gives every agent its own observations: the first axis of every array becomes the agents' (Baker et al.).

    The declarations (`env.observed`) decide:

    - What agents know of themselves and see of each other becomes `<name>_self` (n_agents, ...) and `<name>`
      (n_agents, n_agents - 1, ...); the others are in circulant order: i - 1, i - 2, ... modulo n_agents.
    - Private arrays stay (n_agents, ...), each row for its agent alone; matrices of agents by agents lose the diagonal.
    - Shared arrays are repeated for each agent, (n_agents, ...).
    - All columns about one kind of object are joined in `<kind>_obs` (n_agents, n, ...): its pose, and what mechanics
      add, such as locks and holds.
    - Arrays that repeat other information (`derived`) are left out.

    Args:
        env: environment to wrap.

    Raises:
        ValueError: an observation that is not declared, or whose shape differs from its declaration.
    """

    name = "split_observations"
    # What they add outside would be in no agent's own observations.
    follows = (EatFood, GrabObjects, Lidar, LineOfSight, LockObjects)

    def __init__(self, env: Environment):
        super().__init__(env)
        table = declared_table(env, "SplitObservations")
        n = env.base.n_agents
        self._others = (np.arange(n)[:, None] - np.arange(1, n)) % n
        self._table = {name: one for name, one in table.items() if not one.derived}
        self._joined = _joined(self._table)

    def observation(self, state: State) -> dict[str, jax.Array]:
        n = self.base.n_agents
        split: dict[str, jax.Array] = {}
        for name, one in self._table.items():
            x = state.obs[name]
            if one.is_of_agents and not one.private:
                split |= {f"{name}_self": x, name: x[self._others]}
            elif one.axes[:2] == (AGENT, AGENT):
                split[name] = x[np.arange(n)[:, None], self._others]
            else:
                split[name] = x if one.is_of_agents else jnp.broadcast_to(x, (n, *x.shape))
        for whole, parts in self._joined.items():
            split[whole] = jnp.concatenate([split.pop(part).astype(jnp.float32) for part in parts], axis=-1)
        return split

    def declared(self) -> dict[str, Observed]:
        split: dict[str, Observed] = {}
        for name, one in self._table.items():
            if one.is_of_agents and not one.private:
                split[f"{name}_self"] = replace(one, private=True, present=None, seen=None)
                split[name] = replace(one, axes=(AGENT, OTHER, *one.axes[1:]), private=True)
            elif one.axes[:2] == (AGENT, AGENT):
                split[name] = replace(one, axes=(AGENT, OTHER, *one.axes[2:]))
            else:
                split[name] = replace(one, axes=one.axes if one.is_of_agents else (AGENT, *one.axes), private=True)
        for whole, parts in self._joined.items():
            every = [split.pop(part) for part in parts]
            columns = tuple(column for one in every for column in one.columns)
            split[whole] = replace(every[0], columns=columns)
        return split


def declared_table(env: Environment, who: str, masks: tuple[str, ...] = ("present", "seen")) -> dict[str, Observed]:
    """Returns the declarations of an environment's observations, after checking that all are declared and fit.

    Args:
        env: the environment.
        who: class that needs them, for messages.
        masks: which masks have to be observed, too: those that `who` reads.

    Raises:
        ValueError: an undeclared observation; the message has its name, its source and the line that declares it. Or a
            mask that is not observed, or does not fit.
    """
    table, space = env.observed, env.observation_space.spaces
    shapes = {name: sub.shape or () for name, sub in space.items()}
    for name, shape in shapes.items():
        if name not in table:
            if (dropped := _dropped(env, name)) is not None:
                raise ValueError(
                    f"{who}: {name!r} is observed, and {dropped} leaves out how it was declared; begin what its "
                    "`declared` returns with self.env.declared() | "
                )
            source, call = _origin(env, name)
            line = declaration(name, shape, env.base.n_agents)
            raise ValueError(
                f"{who}: {name!r} is observed and not declared; say whose it is, in {source}: "
                f"def declared(self): return {call}{line}"
            )
    check_shapes(table, shapes, who)
    _check_masks(table, shapes, who, masks)
    return {name: one for name, one in table.items() if name in shapes}


def _dropped(env: Environment, name: str) -> str | None:
    """Returns the class of a wrapper that does not pass on the declaration of an observation; None if there is none."""
    for layer in env.layers:
        inner = getattr(layer, "env", None)
        if inner is not None and name in inner.declared() and name not in layer.declared():
            return type(layer).__name__
    return None


def _origin(env: Environment, name: str) -> tuple[str, str]:
    """Returns the class that adds an observation, and what its `declared` begins with."""
    inner = [layer for layer in env.layers if name in layer.observation_space.spaces]
    if inner and name not in env.base.observation_space.spaces:
        return type(inner[-1]).__name__, "self.env.declared() | "
    for module in env.base.modules.values():
        shapes = jax.eval_shape(module.observation_step, env.base.state_shape.world, env.base.state_shape.data)
        if name in shapes:
            return type(module).__name__, ""
    return type(env).__name__, "self.env.declared() | "


def _joined(table: Mapping[str, Observed]) -> dict[str, list[str]]:
    """Returns, for every kind of object that has `<kind>_obs`, the names of the arrays that are joined to it.

    Only what is hidden by the same masks can share an array, and only columns of different names.
    """
    joined: dict[str, list[str]] = {}
    columns: dict[str, set[str]] = {}
    for name, one in table.items():
        own = one.axes[1:] if one.is_of_agents and one.private else one.axes
        whole = f"{own[0]}_obs" if len(own) == 1 else ""
        if not one.columns or one.critic or whole not in table or own[0] == AGENT:
            continue
        first, known = table[whole], columns.setdefault(whole, set())
        if (one.present, one.seen) == (first.present, first.seen) and not known & set(one.names()):
            joined.setdefault(whole, []).append(name)
            known |= set(one.names())
    return {whole: parts for whole, parts in joined.items() if len(parts) > 1}


def _check_masks(
    table: Mapping[str, Observed], shapes: Mapping[str, tuple[int, ...]], who: str, uses: tuple[str, ...]
) -> None:
    """Refuses arrays whose masks are not observed or do not fit, which would show what is hidden.

    Raises:
        ValueError: naming the array and its mask.
    """
    for name, shape in shapes.items():
        one = table[name]
        for use in uses:
            mask = getattr(one, use)
            if mask is None or not one.columns:
                continue
            if mask not in shapes:
                raise ValueError(f"{who}: {use} of {name!r} is {mask!r}, which is not observed; takes a mask that is")
            axis = one.axes.index(one.entity) if one.entity else 0
            if shapes[mask][-1:] != shape[axis : axis + 1]:
                raise ValueError(
                    f"{who}: {use} of {name!r}, {mask!r}, has shape {shapes[mask]}; takes {shape[axis]} along its last "
                    "axis"
                )
