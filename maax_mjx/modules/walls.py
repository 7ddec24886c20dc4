"""Walls and doors."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.checks import check_choice, check_count
from maax_mjx.layout import Layout, RoomPlan
from maax_mjx.layout import walls as wall_layout
from maax_mjx.layout.walls import Wall
from maax_mjx.modules.module import Module
from maax_mjx.params import DomainParams
from maax_mjx.physics import BOX_FIELDS, Data, Overlay, World, set_boxes
from maax_mjx.worldgen import Floor, Geom

OUTER_HEIGHT = 4.0
INNER_HEIGHT = 0.5
BELOW = -10.0
N_OUTER = 4
N_INNER = {"empty": 0, "quad": 2}


class WallScenarios(Module):
    """Outer walls of 4 m, and the inner walls of 0.5 m of one of the thesis's room scenarios (thesis 4.3.3).

    Walls are geoms of the world body, half a cell thick, on grid lines. An absent piece of wall lies deep below the
    floor.

    Args:
        scenario: "empty" (outer walls only) or "quad" (the quadrant at high x, low y, with a door in each wall).
        door_size: doors in cells; the true opening is one cell and a thickness wider. 0 makes walls without doors.

    Raises:
        ValueError: an unknown scenario or a negative door size; with `Base`, a door wider than its wall.
    """

    name = "walls"

    def __init__(self, scenario: str = "quad", door_size: int = 2):
        self.scenario = check_choice("scenario", scenario, N_INNER)
        self.door_size = check_count("door_size", door_size)
        self.provides_quadrant = self.scenario == "quad"
        self.n_inner = N_INNER[self.scenario]
        self.n_walls = N_OUTER + 2 * self.n_inner

    @property
    def overlay(self) -> Overlay:
        return dict.fromkeys(BOX_FIELDS, self._geom_ids)

    def check(self, grid_size: int, floor_size: float) -> None:
        longest = grid_size // 2 - 1
        if self.n_inner and self.door_size > longest:
            raise ValueError(
                f"door_size: got {self.door_size} cells; takes 0 to {longest}, so that a wall of {grid_size // 2} "
                "cells keeps one on either side"
            )

    def wall_cells(self, grid_size: int) -> int:
        return 4 * grid_size - 4 + self.n_inner * (grid_size // 2)

    def build_step(self, floor: Floor, grid_size: int) -> None:
        self._quadrant = grid_size // 2
        thick = floor.edge / grid_size / 2
        for i in range(self.n_walls):
            height = OUTER_HEIGHT if i < N_OUTER else INNER_HEIGHT
            size = (floor.edge / 2, thick, height)
            floor.append(Geom("box", size, name=f"wall{i}", rgba=(0.6, 0.6, 0.62, 1.0)).mark_static(), "parking")

    def cache_step(self, model: mujoco.MjModel) -> None:
        self._geom_ids = np.array([model.geom(f"wall{i}").id for i in range(self.n_walls)], int)

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        cell, g = layout.grid.cell, layout.grid.size
        outer = wall_layout.outer_walls(g)
        inner = self._inner_walls(jax.random.fold_in(key, layout.attempt), g)
        pieces = [wall_layout.segments(wall, cell) for wall in inner]
        grid = layout.grid
        for wall in [*outer, *inner]:
            grid = wall_layout.mark_wall(grid, wall)
        rects = jnp.concatenate(
            [jnp.stack([wall_layout.segments(wall, cell)[0][0] for wall in outer]), *(rect for rect, _ in pieces)]
        )
        mask = jnp.concatenate([jnp.ones(N_OUTER, bool), *(present for _, present in pieces)])
        doors = [wall_layout.opening(wall, cell) for wall in inner]
        heights = np.array([OUTER_HEIGHT] * N_OUTER + [INNER_HEIGHT] * 2 * self.n_inner, np.float32)
        has_quadrant = self.provides_quadrant
        plan = RoomPlan(
            walls=jnp.where(mask[:, None], rects, 0.0),
            wall_heights=jnp.where(mask, heights, 0.0),
            wall_mask=mask,
            doors=jnp.stack(doors) if doors else jnp.zeros((0, 3)),
            door_mask=jnp.full(self.n_inner, self.door_size > 0),
            quadrant=wall_layout.quadrant_cells(g, self._quadrant) if has_quadrant else jnp.zeros(4, jnp.int32),
        )
        pos, half = _box_geometry(rects, jnp.asarray(heights), mask)
        return layout.replace(grid=grid, plan=plan, fields=set_boxes(layout.fields, self._geom_ids, pos, half))

    def observation_step(self, world: World, data: Data) -> dict[str, jax.Array]:
        """`door_obs` (n_doors, 3): x, y of the middle and the width of every true opening, in metres."""
        if not self.n_inner or not self.door_size:
            return {}
        return {"door_obs": world.plan.doors}

    def _inner_walls(self, key: jax.Array, grid_size: int) -> list[Wall]:
        if self.scenario == "empty":
            return []
        walls = wall_layout.quadrant_walls(grid_size, self._quadrant)
        if not self.door_size:
            return walls
        keys = jax.random.split(key, len(walls))
        return [wall_layout.cut_door(k, wall, self.door_size) for k, wall in zip(keys, walls, strict=True)]


def _box_geometry(rects: jax.Array, heights: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Centres and half extents (n, 3) of walls standing on the floor; absent ones are small, far below it."""
    low, high = rects[:, :2], rects[:, 2:]
    pos = jnp.concatenate([(low + high) / 2, heights[:, None] / 2], axis=1)
    half = jnp.concatenate([(high - low) / 2, heights[:, None] / 2], axis=1)
    parked = jnp.concatenate([pos[:, :2], jnp.full_like(pos[:, :1], BELOW)], axis=1)
    return jnp.where(mask[:, None], pos, parked), jnp.where(mask[:, None], half, 0.01)
