"""Why layouts are invalid: the placements that found no place."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np

from maax_mjx.common.params import DomainParams
from maax_mjx.common.runtime import quick_on_cpu
from maax_mjx.core.composition import Composition
from maax_mjx.core.generation import draw_layout
from maax_mjx.layout.layout import name_of
from maax_mjx.modules import Placed

TOLERATED = 0.01
"""Share of invalid layouts of which nothing is said."""
SAMPLE = 200
"""Layouts that are drawn again to find out what is to blame."""
NAMED = 3
"""Objects that a message names at most."""


def blame(env: Composition, valid: np.ndarray, params: DomainParams) -> str | None:
    """Returns how many of some layouts are invalid, and which placements are to blame; None if few are.

    Worlds do not keep what found no place. Where many are invalid, a sample of other layouts is drawn from the same
    ranges, which costs a compilation.

    Args:
        env: the environment.
        valid: (n,) bool, which layouts are valid.
        params: the ranges that they were drawn from, (n, 2) each, on the host.

    Raises:
        ValueError: no layout is valid, and none of the sample; the message has the placements.
    """
    invalid = np.flatnonzero(~valid)
    if invalid.size <= TOLERATED * valid.size:
        return None
    rows = np.resize(invalid, SAMPLE)
    unplaced, drawn_valid = _draw(env, jax.tree.map(lambda x: x[rows], params))
    failed = ~drawn_valid
    shares = {name: there[failed].mean() for name, there in unplaced.items()} if failed.any() else {}
    worst = sorted((name for name in shares if shares[name]), key=lambda name: -shares[name])[:NAMED]
    if not worst:
        return f"{invalid.size / valid.size:.0%} of {valid.size} layouts are invalid, and no placement is to blame"
    found = ", ".join(f"{_placement(env, name)} in {shares[name]:.0%} of them" for name in worst)
    if failed.all() and not valid.any():
        raise ValueError(
            f"placement_fn: none of {valid.size + SAMPLE} layouts is valid; no place was found for {found}; takes "
            "placements that leave one for everything, fewer objects, or a larger floor"
        )
    return (
        f"{invalid.size / valid.size:.0%} of {valid.size} layouts are invalid, and miss what found no place: {found}. "
        "Other placements, fewer objects or a larger floor leave more of them valid"
    )


def _draw(env: Composition, params: DomainParams) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Draws a layout for each of `SAMPLE` ranges; returns what found no place, and which layouts are valid."""

    @partial(jax.jit, compiler_options=quick_on_cpu(0))
    @jax.vmap
    def draw(key: jax.Array, one: DomainParams) -> tuple[dict[str, jax.Array], jax.Array]:
        layout = draw_layout(env, key, one)
        return layout.unplaced, layout.valid

    return jax.device_get(draw(jax.random.split(jax.random.key(0), SAMPLE), params))


def _placement(env: Composition, name: str) -> str:
    """Returns an object's name and that of its placement."""
    for module in env.modules.values():
        if isinstance(module, Placed) and name in module.names:
            return f"{name} ({name_of(module.placement_fns[module.names.index(name)])})"
    return name
