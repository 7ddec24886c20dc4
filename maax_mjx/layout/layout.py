"""A world's layout while modules draw it, and how an object finds its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import jax
import jax.numpy as jnp
from flax import struct

from maax_mjx.common.checks import array_words, is_real_array
from maax_mjx.common.keys import hashed
from maax_mjx.layout.grid import Grid
from maax_mjx.layout.plan import RoomPlan


class Layout(struct.PyTreeNode):
    """What is drawn so far of one world.

    Attributes:
        grid: the cells that are taken.
        plan: the room plan.
        qpos: (nq,) initial configuration; an entity that is not placed keeps its parking pose.
        fields: model fields in which worlds differ, by MuJoCo's name.
        active: by entity kind, (n_max,) bool.
        objects: by name ("box0"), (3,) the centre of everything placed so far, in metres, and 1, or 0 if it is absent.
        extents: by kind, (n_max, 3) metres, of kinds whose sizes are drawn.
        sites: by kind, (n_max, 3) the centres of marks on the floor, in metres.
        offset: (2,) metres from the corner of its footprint to the centre of the object that is being placed.
        unplaced: by an object's name, or "walls", () bool: whether it was wanted and found no place.
        valid: () bool, whether every wanted object found a place.
        attempt: () int32, which redraw this is. Places depend on it; counts do with `tries` alone.
        tries: how many places are tried for an object before it finds none; None finds one wherever one is free.
    """

    grid: Grid
    plan: RoomPlan
    qpos: jax.Array
    fields: dict[str, jax.Array]
    active: dict[str, jax.Array]
    objects: dict[str, jax.Array]
    extents: dict[str, jax.Array]
    sites: dict[str, jax.Array]
    offset: jax.Array
    unplaced: dict[str, jax.Array]
    valid: jax.Array
    attempt: jax.Array
    tries: int | None = struct.field(pytree_node=False)

    @classmethod
    def empty(cls, grid_size: int, floor_size: jax.Array | float, tries: int | None = None, **own: Any) -> Self:
        """Nothing on an open floor; `own` are the fields of a subclass."""
        return cls(
            grid=Grid.create(grid_size, floor_size),
            plan=RoomPlan.empty(floor_size),
            qpos=jnp.zeros(0),
            fields={},
            active={},
            objects={},
            extents={},
            sites={},
            offset=jnp.zeros(2),
            unplaced={},
            valid=jnp.ones((), bool),
            attempt=jnp.zeros((), jnp.int32),
            tries=tries,
            **own,
        )

    def seeds(self, key: jax.Array, n: int) -> jax.Array:
        """(n, 3) uint32 for `place`: each object's own, however many there are, and new ones at every attempt."""
        seed = hashed(jax.random.bits(key, (3,), jnp.uint32), self.attempt)
        return hashed(seed, jnp.arange(n)[:, None])

    def stacked_objects(self) -> jax.Array:
        """(n, 3) of all `objects`."""
        return jnp.stack(list(self.objects.values())) if self.objects else jnp.zeros((0, 3))

    def noting(self, name: str, unplaced: jax.Array) -> Self:
        """The layout with what found no place, if so; it is not valid then."""
        return self.replace(unplaced=self.unplaced | {name: unplaced}, valid=self.valid & ~unplaced)

    def place(
        self,
        name: str,
        seed: jax.Array,
        extent: jax.Array,
        placement_fn: PlacementFn,
        wanted: jax.Array | bool = True,
    ) -> tuple[Layout, jax.Array, jax.Array]:
        """Finds a place for one object and marks its cells.

        There is a place whenever a cell of positive weight is free; with `tries`, as often as one of so many places
        that are drawn whether free or not would be. The draw hashes the object's own seed with each cell, so that
        another object changes this one's place only by taking its cell.

        Args:
            name: the object's.
            seed: (3,) uint32, this object's; from `seeds`.
            extent: (2,) its extents along x and y in metres.
            placement_fn: where it may go.
            wanted: whether this world has the object at all.

        Returns:
            The layout, the object's centre (2,) in metres, and whether it was placed.
        """
        grid, g = self.grid, self.grid.size
        cells = grid.footprint(extent)
        jitter = (seed[1:] >> 8).astype(jnp.float32) / 2**24
        offset = jitter * jnp.maximum(cells * grid.cell - extent, 0.0) + extent / 2
        try:
            weights = placement_fn(self.replace(offset=offset), cells)
        except ValueError as error:
            raise ValueError(f"placement_fn of {name}: {error}") from error
        if not is_real_array(weights):
            raise ValueError(
                f"placement_fn of {name}: {name_of(placement_fn)} returned {array_words(weights)}; takes an array of "
                f"weights {(g, g)}"
            )
        if jnp.shape(weights) != (g, g):
            raise ValueError(
                f"placement_fn of {name}: {name_of(placement_fn)} returned weights of shape {jnp.shape(weights)}; "
                f"takes {(g, g)}, a weight for every cell that may be the lower left one of what is placed"
            )
        free = grid.free(cells)
        best, found = _pick(seed[0], jnp.asarray(weights), free)
        if self.tries is not None:
            found &= _is_lucky(seed[0], jnp.asarray(weights, float), free, self.tries)
        corner = jnp.stack([best // g, best % g])
        centre = corner * grid.cell + offset
        placed = found & wanted
        layout = self.replace(
            grid=grid.mark(corner, cells, placed),
            objects=self.objects | {name: jnp.append(centre, placed)},
        ).noting(name, ~found & wanted)
        return layout, centre, placed


LUCK = 2**31 + 1
"""What no cell has as its number."""

PlacementFn = Callable[[Layout, jax.Array], jax.Array]
"""`(layout, cells) -> weights`: the layout so far and an object's footprint (2,) in cells to non-negative weights
(G, G) over the cells where its lower-left corner could go; of booleans, all that are true weigh alike. Cells where it
would not fit are ruled out afterwards."""


def _is_lucky(seed: jax.Array, weights: jax.Array, free: jax.Array, tries: int) -> jax.Array:
    """Whether one of so many draws by weight is of a free cell: () bool."""
    share = (weights * free).sum() / jnp.maximum(weights.sum(), 1e-30)
    luck = (hashed(seed, jnp.uint32(LUCK)) >> 8).astype(jnp.float32) / 2**24
    return luck >= (1 - share) ** tries


def name_of(fn: PlacementFn) -> str:
    """A placement function's name, for messages."""
    return getattr(fn, "__name__", type(fn).__name__)


def _pick(seed: jax.Array, weights: jax.Array, free: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A free cell, with probability in proportion to its weight: its index () int32, and whether there is one.

    The smallest score wins. Two minima of integers find it and its cell, in a tenth of the time of an argmin on a CPU.
    """
    cell = jnp.arange(weights.size, dtype=jnp.uint32).reshape(weights.shape)
    draw = hashed(seed, cell)
    if weights.dtype != bool:
        # -log(u) / w is exponential with rate w: it is the smallest with probability w / sum(w). The bits of a float
        # that is not negative are in its order.
        u = ((draw >> 8).astype(jnp.float32) + 0.5) / 2**24
        exponential = -jnp.log(u) / jnp.maximum(weights, 1e-30).astype(jnp.float32)
        draw = jax.lax.bitcast_convert_type(exponential, jnp.uint32)
        free = free & (weights > 0)
    else:
        free = free & weights
    none = jnp.uint32(2**32 - 1)
    score = jnp.where(free, draw, none)
    # Behind a barrier, or the first minimum is computed again for every cell.
    best = jax.lax.optimization_barrier(score.min())
    return jnp.where(score == best, cell, none).min().astype(jnp.int32), best != none
