"""Discrete actions in place of forces."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from maax_mjx.common.annotated import Bounds, check_value
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.wrappers.wrapper import ActionWrapper

Bins = Annotated[int, Bounds(2, 1000)]


def to_bins(forces: Any, n_bins: int) -> Any:
    """Returns the nearest bins to forces in [-1, 1]: int32 of the same shape, in NumPy or JAX as given."""
    return ((forces + 1) / 2 * (n_bins - 1)).round().astype(np.int32)


class DiscretizeActions(ActionWrapper):
    """Takes `action["move"]` as bins (n_agents, 3) int: 0 is full force backwards, the last full force forwards.

    Bins are spread evenly over [-1, 1]; an odd number has rest in its middle. In compiled code, where values cannot be
    checked, bins beyond the last count as the last.

    Args:
        env: environment to wrap.
        n_bins: number of bins, 2 to 1000.

    Raises:
        ValueError: fewer or more bins.
    """

    name = "discretize_actions"

    def __init__(self, env: Environment, n_bins: int = 11):
        super().__init__(env)
        self.n_bins = int(check_value("n_bins", n_bins, Bins))
        self._forces = np.linspace(-1, 1, n_bins, dtype=np.float32)

    @cached_property
    def action_space(self) -> spaces.Dict:
        inner = self.env.action_space.spaces
        return spaces.Dict({**inner, "move": spaces.MultiDiscrete(np.full(inner["move"].shape or (), self.n_bins))})

    def action(self, state: State, action: dict[str, Any]) -> dict[str, Any]:
        bins = jnp.clip(jnp.asarray(action["move"]), 0, self.n_bins - 1).astype(jnp.int32)
        return {**action, "move": jnp.asarray(self._forces)[bins]}
