"""Objects that are placed in a world, in a drawn number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from maax_mjx.common.checks import check_bool, check_count_range, check_per_object
from maax_mjx.common.keys import named_key
from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.layout import Layout, PlacementFn, World
from maax_mjx.modules.module import Module

MOST = 10_000
"""Largest number of objects of one kind."""
RESERVED = ("other", "team", "ray", "corner", "door")
"""Axes of observations that count something else than objects of a module."""


class Places(struct.PyTreeNode):
    """The places of one module's objects.

    Attributes:
        centre: (n_max, 2) metres.
        yaw: (n_max,) radians.
        extents: (n_max, 3) metres along the objects' own axes.
        active: (n_max,) bool, which objects were drawn and found a place.
    """

    centre: jax.Array
    yaw: jax.Array
    extents: jax.Array
    active: jax.Array


class Placed(Module):
    """Objects of one kind. A subclass sets `kind` and implements `write`.

    Args:
        count: number per world, or (low, high).
        placement_fn: one function for all, or a list with one per slot.
        random_yaw: whether each starts at a uniformly random yaw; otherwise all at 0.
        minimum: least number that `count` may have.

    Attributes:
        kind: name of the kind in the singular, such as "box": of the module, of its bodies ("box0"), of its
            observations, and of the axis that counts them.
        count_name: name of the parameter of their number; "n_<kind>s" unless a subclass sets it.
        n_max: number of slots.
        extent: (3,) metres, the largest extents of one object.
        is_round: whether its footprint is the same at every yaw.
    """

    kind: str
    count_name: str = ""
    extent: np.ndarray
    is_round = False

    def __init__(
        self,
        count: int | tuple[int, int],
        placement_fn: PlacementFn | Sequence[PlacementFn],
        *,
        random_yaw: bool = False,
        minimum: int = 0,
    ):
        kind = getattr(self, "kind", None)
        if not isinstance(kind, str) or not kind.isidentifier() or kind in RESERVED:
            raise ValueError(
                f"kind: {type(self).__name__} has {kind!r}; takes a Python identifier such as 'table', in the "
                f"class: what one of its objects is called; {list(RESERVED)} name other axes"
            )
        self.name = self.kind
        self.count_name = self.count_name or f"n_{self.kind}s"
        self.count = check_count_range(self.count_name, count, minimum, MOST)
        self.n_max = self.count[1]
        self.placement_fns: list[Callable] = check_per_object("placement_fn", placement_fn, self.n_max)
        self.random_yaw = check_bool("random_yaw", random_yaw)
        self.requires_quadrant = any(getattr(fn, "requires_quadrant", False) for fn in self.placement_fns)

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        """Smallest and largest number of objects by parameter, in the order of the slots."""
        return {self.count_name: self.count}

    @property
    def plural(self) -> str:
        """The kind's plural, such as "boxes"."""
        return self.count_name.removeprefix("n_")

    @property
    def names(self) -> list[str]:
        """The names of all slots: "box0", "box1", ..."""
        return [f"{self.kind}{i}" for i in range(self.n_max)]

    @property
    def parameters(self) -> list[Parameter]:
        return [Parameter(self.count_name, self.count, (0, self.n_max))]

    @property
    def largest(self) -> np.ndarray:
        """Largest extents (n_max, 3) of every slot, in metres."""
        return np.broadcast_to(self.extent, (self.n_max, 3))

    @property
    def extents(self) -> list[tuple[float, float]]:
        turned = self.random_yaw and not self.is_round
        return [(hypot(x, y),) * 2 if turned else (x, y) for x, y in self.largest[:, :2].tolist()]

    @property
    def sizes_vary(self) -> bool:
        """Whether worlds differ in the objects' sizes."""
        return False

    def extents_of(self, world: World) -> jax.Array:
        """Returns the extents (n_max, 3) of a world's objects along their own axes, in metres."""
        return world.extents[self.kind] if self.sizes_vary else jnp.asarray(self.largest, float)

    def draw_wanted(self, key: jax.Array, params: DomainParams) -> jax.Array:
        """Draws which slots this world uses: (n_max,) bool."""
        counts = params.draw_counts(key, self.counts)
        return jnp.concatenate([jnp.arange(most) < counts[i] for i, (_, most) in enumerate(self.counts.values())])

    def draw_extents(self, key: jax.Array, params: DomainParams, wanted: jax.Array) -> jax.Array:
        """Draws this world's extents (n_max, 3), in metres."""
        return jnp.asarray(self.largest, float)

    def write(self, key: jax.Array, layout: Layout, params: DomainParams, places: Places) -> Layout:
        """Writes the placed objects into the layout."""
        raise NotImplementedError

    def seeds(self, key: jax.Array, layout: Layout) -> jax.Array:
        """Returns (n_max, 3) uint32 seeds for `Layout.place`, one row per slot, independent of the maximum."""
        return layout.seeds(key, self.n_max)

    def layout_step(self, key: jax.Array, layout: Layout, params: DomainParams) -> Layout:
        if not self.n_max:
            return layout.replace(active=layout.active | {self.kind: jnp.zeros(0, bool)})
        wanted = self.draw_wanted(key, params)
        extents = self.draw_extents(key, params, wanted)
        yaw = self._draw_yaw(key, layout)
        turned = extents[:, :2] if self.is_round else turned_extents(extents, yaw)
        seeds = self.seeds(key, layout)
        centres, placed = [], []
        for i, fn in enumerate(self.placement_fns):
            layout, centre, ok = layout.place(self.names[i], seeds[i], turned[i], fn, wanted[i])
            centres.append(centre)
            placed.append(ok)
        places = Places(jnp.stack(centres), yaw, extents, jnp.stack(placed))
        layout = layout.replace(active=layout.active | {self.kind: places.active})
        if self.sizes_vary:
            layout = layout.replace(extents=layout.extents | {self.kind: extents})
        return self.write(key, layout, params, places)

    def _draw_yaw(self, key: jax.Array, layout: Layout) -> jax.Array:
        """Draws yaws (n_max,) in [0, 2 pi) radians; zeros unless `random_yaw`."""
        if not self.random_yaw:
            return jnp.zeros(self.n_max)
        bits = self.seeds(named_key(key, "yaw"), layout)[:, 0]
        return (bits >> 8).astype(jnp.float32) / 2**24 * 2 * jnp.pi


def turned_extents(extents: jax.Array, yaw: jax.Array) -> jax.Array:
    """Returns extents (n, 2) in metres of the bounding boxes of boxes (n, 3) turned by yaw (n,) radians."""
    x, y = extents[:, 0], extents[:, 1]
    cos, sin = jnp.abs(jnp.cos(yaw)), jnp.abs(jnp.sin(yaw))
    return jnp.stack([cos * x + sin * y, sin * x + cos * y], axis=1)
