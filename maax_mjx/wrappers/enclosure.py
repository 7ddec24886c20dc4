"""Where agents can get to on the floor, and which doors are shut: geometry seen from above, for one world."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from maax_mjx.layout.plan import RoomPlan

CELLS = 60
"""Cells along an edge of the floor; of M's floor, 0.1 m each."""
RING = 3
"""Cells around the floor, through which agents go where nothing keeps them on it."""
GAP = 0.3
"""Metres of a free opening below which a door counts as shut: an agent is 0.3 m wide."""
ALONG, ACROSS = 24, 7
"""Points at which an opening is looked at."""


class Footprints(NamedTuple):
    """Rectangles on the floor.

    Attributes:
        centre: (n, 2) metres.
        half: (n, 2) half of their extents along their own axes, in metres; 0 and less is nothing.
        turn: (n, 2) cosine and sine of their yaw.
    """

    centre: jax.Array
    half: jax.Array
    turn: jax.Array

    def clearance(self, points: jax.Array) -> jax.Array:
        """Returns metres (...) from points (..., 2) to the nearest of them; 0 inside, infinite without any."""
        x, y = (points[..., i, None] - self.centre[:, i] for i in range(2))
        cos, sin = self.turn[:, 0], self.turn[:, 1]
        along = jnp.maximum(jnp.abs(cos * x + sin * y) - self.half[:, 0], 0.0)
        across = jnp.maximum(jnp.abs(cos * y - sin * x) - self.half[:, 1], 0.0)
        squared = jnp.where((self.half > 0).all(axis=-1), along**2 + across**2, jnp.inf)
        return jnp.sqrt(squared.min(axis=-1, initial=jnp.inf))


def walls_of(plan: RoomPlan) -> Footprints:
    """Returns the footprints of a plan's walls."""
    low, high = plan.walls[:, :2], plan.walls[:, 2:]
    half = jnp.where(plan.wall_mask[:, None], (high - low) / 2, 0.0)
    return Footprints((low + high) / 2, half, jnp.broadcast_to(jnp.array([1.0, 0.0]), low.shape))


def enclosed(plan: RoomPlan, things: Footprints, radius: float, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Returns () bool, whether discs of a radius cannot get along the floor from any start to any goal.

    A flood fill over cells whose middles have room for the disc. A disc that touches a wall stands in a cell without
    room, so that it begins, and is found, in the cells around it, too.

    Args:
        plan: walls, and whether anything keeps agents on the floor.
        things: what stands in the way besides the walls.
        radius: of the discs, in metres.
        start: (n, 3) x and y in metres, and 1, or 0 for none.
        goal: (m, 3) likewise.
    """
    cell = plan.floor_size / CELLS
    middles = (jnp.arange(-RING, CELLS + RING) + 0.5) * cell
    points = jnp.stack(jnp.meshgrid(middles, middles, indexing="ij"), axis=-1)
    room = jnp.minimum(walls_of(plan).clearance(points), things.clearance(points)) >= radius
    outside = ((points < 0) | (points > plan.floor_size)).any(axis=-1)
    room &= ~(outside & plan.closed)
    # Half a cell more than the diagonal's half: the cells around the one that a disc's middle is in.
    reach = 1.3 * cell

    def near(discs: jax.Array) -> jax.Array:
        close = (jnp.abs(points[..., None, :] - discs[:, :2]) <= reach).all(axis=-1)
        return (close & (discs[:, 2] > 0)).any(axis=-1)

    return ~(flooded(room, near(start)) & near(goal)).any()


def flooded(free: jax.Array, start: jax.Array) -> jax.Array:
    """Returns the cells (n, m) bool that are reached from the starting cells along free ones, by their edges."""
    # Small integers: batches of floors are read and written many times.
    whole = jnp.int8 if max(free.shape) <= jnp.iinfo(jnp.int8).max else jnp.int32
    index = [jax.lax.broadcasted_iota(whole, free.shape, axis) for axis in (0, 1)]

    def along(reached: jax.Array, axis: int, backwards: bool) -> jax.Array:
        """Spreads in one direction, past all cells up to the next that is not free."""
        place = free.shape[axis] - 1 - index[axis] if backwards else index[axis]
        last = [jax.lax.cummax(jnp.where(x, place, whole(-1)), axis, reverse=backwards) for x in (reached, ~free)]
        return free & (last[0] > last[1])

    def spread(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        reached, _ = carry
        after = reached
        for axis in (0, 1):
            after = along(after, axis, False) | along(after, axis, True)
        return after, (after != reached).any()

    return jax.lax.while_loop(lambda carry: carry[1], spread, (start & free, jnp.ones((), bool)))[0]


def doors_shut(plan: RoomPlan, things: Footprints) -> jax.Array:
    """Returns (n_doors,) bool, which doors have no free way of `GAP` through them; False where there is no door.

    The opening is looked at along lines parallel to its wall, up to `GAP` before and behind its middle: what stands
    nearer than that in front of a door shuts it as well as what stands in it.
    """
    walls = walls_of(plan)

    def shut(door: jax.Array) -> jax.Array:
        middle, width = door[:2], door[2]
        axes = jnp.eye(2)
        # Along its wall, both ends of the opening meet wall; across it, none does.
        ends = middle + axes[:, None] * (jnp.array([-1.0, 1.0])[:, None] * (width / 2 + 0.05))
        in_wall = (walls.clearance(ends) <= 0).all(axis=1)
        along = jnp.where(in_wall[0], axes[0], axes[1])
        steps = ((jnp.arange(ALONG) + 0.5) / ALONG - 0.5) * width
        offsets = jnp.linspace(-GAP, GAP, ACROSS)
        points = middle + steps[:, None] * along + offsets[:, None, None] * along[::-1]
        free = things.clearance(points) > 0

        def longest(run: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
            run = jnp.where(x, run + 1, 0)
            return run, run

        runs = jax.lax.scan(longest, jnp.zeros(ACROSS, jnp.int32), free.T)[1].max(axis=0)
        return runs.min() * width / ALONG < GAP

    if not plan.doors.shape[0]:
        return jnp.zeros(0, bool)
    return jax.vmap(shut)(plan.doors) & plan.door_mask
