"""Checks of what users' modules return, in sentences that name the class."""

from __future__ import annotations

from collections.abc import Collection
from difflib import get_close_matches
from operator import attrgetter
from typing import Any

import jax
import mujoco

from maax_mjx.common.checks import described
from maax_mjx.common.observed import check_arrays
from maax_mjx.common.params import DomainParams
from maax_mjx.layout import Layout, World
from maax_mjx.modules import Module
from maax_mjx.physics import Data, Overlay


def checked_layout(
    module: Module, key: jax.Array, layout: Layout, params: DomainParams, model: mujoco.MjModel
) -> Layout:
    """Runs a module's `layout_step`.

    Raises:
        ValueError: it returns no layout, reads or writes a model field that is in no overlay, or changes the shape of
            a field or of `qpos`.
    """
    mine = type(module).__name__
    try:
        drawn = module.layout_step(key, layout, params)
    except KeyError as error:
        (name,) = error.args
        if isinstance(name, str) and name not in layout.fields and _is_field(model, name):
            raise _not_overlaid(mine, name) from error
        raise
    if not isinstance(drawn, Layout):
        raise ValueError(
            f"layout_step: {mine} returned {described(drawn)}; takes the layout that it was given, changed with "
            "layout.replace(...)"
        )
    for name in drawn.fields:
        if name not in layout.fields:
            raise _not_overlaid(mine, name)
    before, after = ({"qpos": one.qpos} | one.fields for one in (layout, drawn))
    for name, array in before.items():
        got = after[name].shape if name in after else None
        if got != array.shape:
            raise ValueError(
                f"layout_step: {mine} returned {name!r} with the shape {got}; takes {array.shape}, the whole field"
            )
    return drawn


def checked_overlay(module: Module, model: mujoco.MjModel) -> Overlay:
    """Reads a module's `overlay`.

    Raises:
        ValueError: a field that MuJoCo's model has not.
    """
    overlay = module.overlay
    for name in overlay:
        if not _is_field(model, name):
            near = get_close_matches(name, dir(model), 1)
            raise ValueError(
                f"overlay: {type(module).__name__} has {name!r}, which is no field of mujoco.MjModel; takes rows by "
                f"field{f', such as {near[0]!r}' if near else ''}"
            )
    return overlay


def checked_observations(module: Module, world: World, data: Data) -> dict[str, jax.Array]:
    """Runs a module's `observation_step`.

    Raises:
        ValueError: it returns something else than a dict of arrays.
    """
    obs: Any = module.observation_step(world, data)
    return check_arrays(obs, "observation_step", type(module).__name__)


def check_names(module: Module, names: Collection[str], other: Module, others: Collection[str]) -> None:
    """Refuses observations of one name by two modules.

    Raises:
        ValueError: a name that both have.
    """
    if twice := sorted(set(names) & set(others)):
        raise ValueError(
            f"module: {type(module).__name__} {module.name!r} observes {twice[0]!r}, as {type(other).__name__} "
            f"{other.name!r} does; takes another name"
        )


def declared_names(module: Module) -> Collection[str]:
    """Returns the declared names; none of a module that needs the model for them, which the first reset checks."""
    try:
        return module.declared()
    except RuntimeError:
        return ()


def _is_field(model: mujoco.MjModel, name: str) -> bool:
    try:
        attrgetter(name)(model)
    except AttributeError:
        return False
    return True


def _not_overlaid(mine: str, name: str) -> ValueError:
    return ValueError(
        f"layout_step: {mine} uses the field {name!r}, in which worlds do not differ; name its rows in "
        f'{mine}.overlay: {{"{name}": ids}}'
    )
