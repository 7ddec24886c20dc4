"""Building a shelter: rays that are to be kept from a cylinder (Baker et al.'s transfer task)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.annotated import NonNegative, PositiveCount, check_value
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import StaticCylinders
from maax_mjx.modules.from_model import from_model
from maax_mjx.physics.rays import NO_BODY, Rays
from maax_mjx.wrappers.wrapper import RewardWrapper

INSET = 1.01
"""Cells between the edge of the floor and where rays start."""


class ShelterReward(RewardWrapper):
    """Takes from every agent `scale` points at every step for every ray that gets to a cylinder, by the published code.

    Rays start on the floor, evenly along a square just inside its edge, and go to the middle of a `StaticCylinders`. A
    ray counts if the cylinder is the first thing that it meets: boxes around it, walls and agents stop rays.

    Args:
        env: environment to wrap, with `StaticCylinders`; rays go to each of them.
        rays_per_side: of the square.
        scale: points.

    Raises:
        ValueError: no such cylinder, or a number out of its range.
    """

    name = "shelter"

    def __init__(self, env: Environment, rays_per_side: int = 25, scale: float = 0.001):
        super().__init__(env)
        self.cylinders = self.module_of(StaticCylinders)
        self.rays_per_side = int(check_value("rays_per_side", rays_per_side, PositiveCount))
        self.scale = float(check_value("scale", scale, NonNegative))
        self.starts = _starts(self.rays_per_side, self.base.floor_size, self.base.grid_size)

    @from_model
    def _rays(self) -> Rays:
        return Rays(self.base.model, self.base.overlay)

    def reward(self, state: State) -> jax.Array:
        lost = self.scale * self.reaching(state).sum()
        return jnp.where(self.playing(state), state.reward - lost, state.reward)

    def reaching(self, state: State) -> jax.Array:
        """Which rays get to which cylinder: (4 * rays_per_side, n_cylinders) bool; none to an absent one."""
        geoms = self.cylinders.geom_ids
        to = state.data.geom_xpos[geoms] - self.starts[:, None]
        direction = to / jnp.linalg.norm(to, axis=-1, keepdims=True)
        nobody = np.full(len(self.starts), NO_BODY)
        _, met = self._rays.cast(state.world.fields, state.data, jnp.asarray(self.starts), direction, nobody)
        return (met == geoms) & state.world.active[self.cylinders.kind]


def _starts(n: int, floor_size: float, grid_size: int) -> np.ndarray:
    """Where rays start, (4 n, 3) metres: n along each side of a square, from a corner on, without the next corner."""
    low = INSET * floor_size / grid_size
    high = floor_size - low
    along = np.arange(n) / n * (high - low)
    sides = (
        (low + along, np.full(n, low)),
        (np.full(n, high), low + along),
        (high - along, np.full(n, high)),
        (np.full(n, low), high - along),
    )
    flat = np.concatenate([np.stack(side, axis=1) for side in sides])
    return np.pad(flat, ((0, 0), (0, 1))).astype(np.float32)
