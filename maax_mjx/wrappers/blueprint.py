"""Building from a blueprint: boxes that are to fill construction sites (Baker et al.'s transfer task)."""

from __future__ import annotations

from typing import Annotated, Any

import jax
import jax.numpy as jnp

from maax_mjx.common.annotated import Bounds, NonNegative, Positive, check_value
from maax_mjx.common.observed import POSITION, Observed
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State
from maax_mjx.modules import Boxes, ConstructionSites
from maax_mjx.modules.sites import CORNERS
from maax_mjx.physics.rotation import rotate
from maax_mjx.wrappers.wrapper import ObservationWrapper, Wrapper

Steepness = Annotated[float, Bounds(-1000, 0)]


def box_corners(boxes: Boxes, state: State) -> jax.Array:
    """Returns the four corners of boxes at half their height, as they lie: (n_boxes, 4, 3) metres. Pure.

    In the order of those of `ConstructionSites`; those of absent boxes mean nothing.
    """
    flat = boxes.extents_of(state.world)[:, None, :2] * CORNERS
    offset = jnp.pad(flat, ((0, 0), (0, 0), (0, 1)))
    quat = jnp.broadcast_to(state.data.xquat[boxes.body_ids][:, None], (*offset.shape[:-1], 4))
    return state.data.xpos[boxes.body_ids][:, None] + rotate(quat, offset)


class BoxCorners(ObservationWrapper):
    """Adds `box_corner_pos` (n_boxes, 4, 3): the corners of boxes at half their height, in metres (Baker et al.).

    They move and turn with the boxes, in the order of those of `ConstructionSites`; absent boxes are zero.

    Args:
        env: environment to wrap, with `Boxes`.

    Raises:
        ValueError: no boxes.
    """

    name = "box_corners"

    def __init__(self, env: Environment):
        super().__init__(env)
        self.boxes = self.module_of(Boxes)

    def observation(self, state: State) -> dict[str, jax.Array]:
        there = state.world.active[self.boxes.kind][:, None, None]
        corners = jnp.where(there, box_corners(self.boxes, state), 0.0)
        return state.obs | {f"{self.boxes.kind}_corner_pos": corners}

    def declared(self) -> dict[str, Observed]:
        corners = Observed((self.boxes.kind, "corner"), POSITION)
        return self.env.declared() | {f"{self.boxes.kind}_corner_pos": corners}


class BlueprintReward(Wrapper):
    """Adds a reward for boxes that fill construction sites, by the published code; the episode ends when all are full.

    Every agent loses at every step `scale` times the mean distance of the sites' corners to the boxes' corners: to all
    of them, each with the weight exp(`steepness` * distance), so that near ones count most. All sites are full if each
    has a box's centre, and each of their corners a box's corner, nearer than `radius`: then every agent gets
    `completed` for each site, and the episode ends.

    Args:
        env: environment to wrap, with `Boxes` and `ConstructionSites`.
        scale: points for a metre.
        steepness: not positive, per metre; 0 takes the mean distance.
        completed: points for a site.
        radius: metres.

    Attributes:
        boxes, sites: the modules.

    Raises:
        ValueError: no boxes or sites, or a number out of its range.
    """

    name = "blueprint"

    def __init__(
        self,
        env: Environment,
        scale: float = 0.05,
        steepness: float = -1.5,
        completed: float = 3.0,
        radius: float = 0.1,
    ):
        super().__init__(env)
        self.boxes, self.sites = self.module_of(Boxes), self.module_of(ConstructionSites)
        self.scale = float(check_value("scale", scale, NonNegative))
        self.steepness = float(check_value("steepness", steepness, Steepness))
        self.completed = float(check_value("completed", completed, NonNegative))
        self.radius = float(check_value("radius", radius, Positive))

    def transition(self, state: State, action: dict[str, Any]) -> State:
        state = self.env.advance(state, action)
        sites, boxes = self._there(state)
        away, full = self._corners_away(state), self.is_full(state)
        weights = jnp.exp(self.steepness * away) * jnp.repeat(boxes, 4)
        nearest = (away * weights).sum(axis=1) / jnp.maximum(weights.sum(axis=1), jnp.finfo(weights.dtype).tiny)
        mean = jnp.where(jnp.repeat(sites, 4), nearest, 0.0).sum() / jnp.maximum(4 * sites.sum(), 1)
        reward = full * self.completed * sites.sum() - self.scale * mean
        paid = jnp.where(self.playing(state), state.reward + reward, state.reward)
        return state.replace(reward=paid, terminated=state.terminated | full)

    def is_full(self, state: State) -> jax.Array:
        """Whether all sites are full: () bool; never without a site."""
        sites, boxes = self._there(state)
        centres = state.data.xpos[self.boxes.body_ids]
        of_centres = jnp.linalg.norm(state.world.sites[self.sites.kind][:, None] - centres, axis=-1)
        met = ((of_centres < self.radius) & boxes).any(axis=1)
        of_corners = (self._corners_away(state) < self.radius) & jnp.repeat(boxes, 4)
        met &= of_corners.any(axis=1).reshape(-1, 4).all(axis=1)
        return (met | ~sites).all() & sites.any()

    def _corners_away(self, state: State) -> jax.Array:
        """Metres from all corners of sites to all corners of boxes: (4 n_sites, 4 n_boxes)."""
        of_sites = self.sites.corners(state.world).reshape(-1, 3)
        return jnp.linalg.norm(of_sites[:, None] - box_corners(self.boxes, state).reshape(-1, 3), axis=-1)

    def _there(self, state: State) -> tuple[jax.Array, jax.Array]:
        """Which sites and which boxes the world has."""
        return state.world.active[self.sites.kind], state.world.active[self.boxes.kind]
