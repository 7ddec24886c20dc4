"""Placement functions: where an object may go, as weights over the grid (thesis 4.3.3).

A placement function maps `(layout, cells)` to (G, G) weights for the cell of the object's lower-left corner; `cells`
(2,) is its footprint. Whether the cells are free is checked by the caller. A function that needs a quadrant says so
with `@requires_quadrant`, so that a missing one is an error when the environment is composed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, reduce, wraps
from typing import Any, ParamSpec

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.common.checks import check_count, check_positive
from maax_mjx.layout.grid import apart, within
from maax_mjx.layout.layout import Layout, PlacementFn, name_of

ROUNDING = 1e-5
"""Metres that distances may be off by in float32."""


Rect = tuple[Any, Any]
"""The lower-left cell (2,) of a rectangle, and the one beyond its upper right."""

Region = Callable[[int, Any, Any], Rect]
"""`(grid_size, cell, cells) -> rectangle`: the cells that an object's footprint (2,) may take, by the edge of a cell in
metres, in every world with such a floor. Plain arithmetic, for NumPy and JAX alike."""


def region_of(fn: PlacementFn) -> Region | None:
    """The region that a placement function keeps to in every world; None if it depends on the world."""
    return getattr(fn, "region", None)


def anchors_of(*fns: PlacementFn) -> frozenset[str]:
    """The names of the objects that placement functions measure distances from."""
    return frozenset().union(*(getattr(fn, "anchors", ()) for fn in fns))


def separation_of(fn: PlacementFn) -> float:
    """Metres that a placement function keeps from all that was placed before; 0 if it keeps none."""
    return getattr(fn, "separation", 0.0)


def rooms_of(fn: PlacementFn) -> int:
    """How many rooms a world needs for a placement function to read."""
    return getattr(fn, "rooms", 0)


FAR = 1e6
"""Cells that are off any floor."""
P = ParamSpec("P")


class Made:
    """A placement function that a factory made. It is pickled as the call that made it.

    Args:
        fn: the function; its name and marks are those of this one.
        made: makes it again.
    """

    def __init__(self, fn: PlacementFn, made: Callable[[], PlacementFn]):
        self.__dict__.update(vars(fn))
        self.__name__, self._fn, self._made = name_of(fn), fn, made

    def __call__(self, layout: Layout, cells: jax.Array) -> jax.Array:
        return self._fn(layout, cells)

    def __repr__(self) -> str:
        return self.__name__

    def __reduce__(self) -> tuple[Callable[[], PlacementFn], tuple[()]]:
        return self._made, ()


def made(factory: Callable[P, PlacementFn]) -> Callable[P, PlacementFn]:
    """Lets what a factory of placement functions makes be pickled."""

    @wraps(factory)
    def make(*args: P.args, **kwargs: P.kwargs) -> PlacementFn:
        return Made(factory(*args, **kwargs), partial(make, *args, **kwargs))

    return make


def requires_quadrant(fn: PlacementFn) -> PlacementFn:
    """Marks a placement function that reads `layout.plan.quadrant`."""
    fn.requires_quadrant = True  # type: ignore[attr-defined]
    return fn


def uniform_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows any place on the floor."""
    return jnp.ones((layout.grid.size, layout.grid.size), bool)


@requires_quadrant
def quad_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows places inside the quadrant; any in a world without one, where a batch mixes scenarios."""
    return _or_anywhere(within(layout.grid.size, cells, layout.plan.quadrant), _has_quadrant(layout))


quad_placement.inside_quadrant = True  # type: ignore[attr-defined]
"""What asks for the quadrant alone must fit into it."""


@requires_quadrant
def outside_quad_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows places outside the quadrant, uniformly by area (OpenAI picks one of three rectangles around it instead).

    Any place in a world without one.
    """
    return _or_anywhere(apart(layout.grid.size, cells, layout.plan.quadrant), _has_quadrant(layout))


def centre_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows the middle of the floor alone, to the cell."""
    return _inside(layout, cells, _centre)


def _centre(grid_size: int, cell: jax.Array, cells: jax.Array) -> Rect:
    corner = (grid_size - cells) // 2
    return corner, corner + cells


centre_placement.region = _centre  # type: ignore[attr-defined]


@made
def at_placement(x: float, y: float) -> PlacementFn:
    """A placement of the object's middle at a point in metres, to the cell.

    There is no place where the object would leave the floor.

    Args:
        x: metres from the floor's lower left corner.
        y: likewise.

    Raises:
        ValueError: a coordinate that is not positive.
    """
    point = np.array([check_positive("x", x), check_positive("y", y)], np.float32)

    def region(grid_size: int, cell: jax.Array, cells: jax.Array) -> Rect:
        corner = (point / cell - cells / 2).round().clip(-FAR, FAR).astype(np.int32)
        return corner, corner + cells

    return _within_region(f"at_placement({x:g}, {y:g})", region)


@made
def middle_placement(fraction: float) -> PlacementFn:
    """A placement in the central square whose edge is `fraction` of the floor's.

    Raises:
        ValueError: a fraction outside (0, 1].
    """
    fraction = _check_fraction(fraction)

    def region(grid_size: int, cell: jax.Array, cells: jax.Array) -> Rect:
        margin = int(grid_size * (1 - fraction) / 2 + 1e-6)
        return np.full(2, margin), np.full(2, grid_size - margin)

    return _within_region(f"middle_placement({fraction:g})", region)


@made
def published_middle_placement(fraction: float) -> PlacementFn:
    """A placement around the middle of the floor, in the range of cells of OpenAI's `uniform_placement_middle`.

    The lowest cell of an object of s cells, on a grid of G, is from int((G - s) (1 - f) / 2 + f) to
    int((G - s) (1 + f) / 2 - f) - 1: a little less than `middle_placement` allows, and more to the lower left.

    Raises:
        ValueError: a fraction outside (0, 1].
    """
    fraction = _check_fraction(fraction)

    def region(grid_size: int, cell: jax.Array, cells: jax.Array) -> Rect:
        free = grid_size - cells
        low = (free * (1 - fraction) / 2 + fraction).astype(np.int32)
        high = (free * (1 + fraction) / 2 - fraction).astype(np.int32) - 1
        return low, high + cells

    return _within_region(f"published_middle_placement({fraction:g})", region)


@made
def separation_placement(radius: float) -> PlacementFn:
    """A placement at least `radius` metres from all that was placed before, centre to centre (thesis 4.3.3).

    Raises:
        ValueError: a radius that is not positive; with `Base`, one that is too large for its floor.
    """
    radius = check_positive("radius", radius)

    def placement(layout: Layout, cells: jax.Array) -> jax.Array:
        objects = layout.stacked_objects()
        far = _distances(layout, objects[:, :2]) >= radius + ROUNDING
        return (far | (objects[:, 2] == 0)).all(axis=-1)

    placement.separation = radius  # type: ignore[attr-defined]
    placement.__name__ = f"separation_placement({radius:g})"
    return placement


@made
def proximity_placement(radius: float, to: str) -> PlacementFn:
    """A placement at most `radius` metres from the object named `to`, such as "box0", centre to centre (thesis 4.3.3).

    Anywhere in a world where that object is not in play, and for that object itself, so that one placement serves all
    objects of a module.

    Raises:
        ValueError: a radius that is not positive, or a name that is not a string; with `Base`, an object that there is
            not, or that is placed later.
    """
    radius, to = check_positive("radius", radius), _check_anchor(to)

    def placement(layout: Layout, cells: jax.Array) -> jax.Array:
        anchor = layout.objects.get(to, jnp.zeros(3))
        near = _distances(layout, anchor[None, :2])[..., 0] <= radius - ROUNDING
        return _or_anywhere(near, anchor[2] > 0)

    placement.anchors = frozenset([to])  # type: ignore[attr-defined]
    placement.__name__ = f"proximity_placement({radius:g}, {to!r})"
    return placement


def published_uniform_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows any place in the range of cells of OpenAI's `uniform_placement`: none at the edges of the floor.

    The lowest cell of an object of s cells, on a grid of G, is from 1 to G - s - 2.
    """
    return _inside(layout, cells, _published_uniform)


def _published_uniform(grid_size: int, cell: jax.Array, cells: jax.Array) -> Rect:
    return np.full(2, 1), np.full(2, grid_size - 2)


published_uniform_placement.region = _published_uniform  # type: ignore[attr-defined]


@requires_quadrant
def published_quad_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows places inside the quadrant in the range of cells of OpenAI's `quadrant_placement`; any without one."""
    g, (left, size) = layout.grid.size, _quadrant_lines(layout)
    allowed = within(g, cells, jnp.stack([left, 1, g - 2, size - 2]))
    return _or_anywhere(allowed, _has_quadrant(layout))


published_quad_placement.inside_quadrant = True  # type: ignore[attr-defined]


@requires_quadrant
def published_outside_quad_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows places outside the quadrant as OpenAI's `outside_quadrant_placement`: in one of three rectangles.

    Each of the rectangles, to its left, above that, and above it, is drawn as often as the others, however large it is.
    Any place in a world without a quadrant.
    """
    g, (left, size) = layout.grid.size, _quadrant_lines(layout)
    beside, above = (1, left - 2), (size, g - 2)
    parts: list[Any] = [(beside, (1, size - 2)), (beside, above), ((left, g - 2), above)]
    allowed = [within(g, cells, jnp.stack([x[0], y[0], x[1], y[1]])) for x, y in parts]
    weights = sum(part / jnp.maximum(part.sum(), 1) for part in allowed)
    return jnp.where(_has_quadrant(layout), weights, 1.0)


def _quadrant_lines(layout: Layout) -> tuple[jax.Array, jax.Array]:
    """The cells of the lines of a quadrant's walls, along x and along y."""
    quadrant = layout.plan.quadrant
    return quadrant[0] - 1, quadrant[3]


@made
def published_proximity_placement(radius: float, to: str) -> PlacementFn:
    """A placement near the object named `to`, in the range of cells of OpenAI's `close_to_other_object_placement`.

    With r cells in the radius, rounded up, the lowest cell of an object is from r cells below that of the other to
    r - 1 above it on each axis, and not the first or last of the floor: a square, where `proximity_placement` has a
    disc.
    The other object has as many cells. Anywhere in a world where that object is not in play.

    Raises:
        ValueError: as `proximity_placement`.
    """
    radius, to = check_positive("radius", radius), _check_anchor(to)

    def placement(layout: Layout, cells: jax.Array) -> jax.Array:
        anchor, g = layout.objects.get(to, jnp.zeros(3)), layout.grid.size
        reach = jnp.ceil(radius / layout.grid.cell - ROUNDING)
        corner = jnp.round(anchor[:2] / layout.grid.cell - cells / 2)
        low, high = jnp.maximum(corner - reach, 1), jnp.minimum(corner + reach, g - 1)
        along = [(jnp.arange(g) >= low[i]) & (jnp.arange(g) < high[i]) for i in range(2)]
        return _or_anywhere(along[0][:, None] & along[1], anchor[2] > 0)

    placement.anchors = frozenset([to])  # type: ignore[attr-defined]
    placement.__name__ = f"published_proximity_placement({radius:g}, {to!r})"
    return placement


@made
def room_placement(index: int) -> PlacementFn:
    """A placement inside rectangular room `index` of the room plan; anywhere in a world that does not have it.

    Raises:
        ValueError: a negative index; with `Base`, one that no world of the environment has.
    """
    return _room_placement("room_placement", index, lambda layout: layout.plan.rooms)


@made
def published_room_placement(index: int) -> PlacementFn:
    """A placement inside room `index` in the range of cells of OpenAI's `tri_placement`.

    Towards higher x and y it leaves a free cell empty at outer walls, and two at inner ones.

    Raises:
        ValueError: as `room_placement`.
    """
    return _room_placement("published_room_placement", index, _published_rooms)


def _room_placement(name: str, index: int, rooms_of: Callable[[Layout], jax.Array]) -> PlacementFn:
    check_count("index", index)

    def placement(layout: Layout, cells: jax.Array) -> jax.Array:
        rooms = rooms_of(layout)
        if index >= rooms.shape[0]:
            raise ValueError(f"{name}: got room {index}; worlds of this environment have {rooms.shape[0]}")
        return _or_anywhere(within(layout.grid.size, cells, rooms[index]), layout.plan.room_mask[index])

    placement.rooms = index + 1  # type: ignore[attr-defined]
    placement.__name__ = f"{name}({index})"
    return placement


def _published_rooms(layout: Layout) -> jax.Array:
    """The rooms (n, 4) in cells, as far as OpenAI's code places things in them."""
    rooms = layout.plan.rooms
    return rooms.at[:, 2:].add(jnp.where(rooms[:, 2:] == layout.grid.size - 1, -1, -2))


def rooms_in_turn_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """Allows one of the rectangular rooms that have least of what was placed before, each of them as likely.

    So no room gets a second object before every room has one (OpenAI's `rotate_tri_placement`). Anywhere in a world
    without rooms.
    """
    return _in_turn(layout, cells, layout.plan.rooms)


def published_rooms_in_turn_placement(layout: Layout, cells: jax.Array) -> jax.Array:
    """The same in the ranges of cells of OpenAI's code, see `published_room_placement`.

    There a place that is not free costs a room its turn; here it does not.
    """
    return _in_turn(layout, cells, _published_rooms(layout))


def _in_turn(layout: Layout, cells: jax.Array, rooms: jax.Array) -> jax.Array:
    plan, placed = layout.plan, layout.stacked_objects()
    if not plan.rooms.shape[0]:
        return uniform_placement(layout, cells)
    at = placed[:, None, :2] / layout.grid.cell
    inside = ((at > plan.rooms[:, :2]) & (at < plan.rooms[:, 2:])).all(axis=-1) & (placed[:, None, 2] > 0)
    number = jnp.where(plan.room_mask, inside.sum(axis=0), len(placed) + 1)
    turn = (number == number.min()) & plan.room_mask
    allowed = jax.vmap(partial(within, layout.grid.size, cells))(rooms) & turn[:, None, None]
    share = allowed / jnp.maximum(allowed.sum(axis=(1, 2), keepdims=True), 1)
    return jnp.where(plan.room_mask.any(), share.sum(axis=0), 1.0)


@made
def all_of(*fns: PlacementFn) -> PlacementFn:
    """A placement where all of these allow it: the product of their weights.

    Raises:
        ValueError: no functions.
    """
    placement = _combined("all_of", fns, lambda a, b: a * b)
    placement.separation = max(map(separation_of, fns))  # type: ignore[attr-defined]
    placement.inside_quadrant = any(getattr(fn, "inside_quadrant", False) for fn in fns)  # type: ignore[attr-defined]
    regions = [region for fn in fns if (region := region_of(fn)) is not None]
    if regions:

        def region(grid_size: int, cell: jax.Array, cells: jax.Array) -> Rect:
            lows, highs = zip(*(one(grid_size, cell, cells) for one in regions), strict=True)
            return reduce(jnp.maximum, lows), reduce(jnp.minimum, highs)

        placement.region = region  # type: ignore[attr-defined]
    return placement


@made
def any_of(*fns: PlacementFn) -> PlacementFn:
    """A placement where any of these allows it: the sum of their weights; of booleans, all that are true weigh alike.

    Raises:
        ValueError: no functions.
    """
    return _combined("any_of", fns, lambda a, b: a + b)


def _combined(name: str, fns: tuple[PlacementFn, ...], combine: Callable) -> PlacementFn:
    if not fns or not all(callable(fn) for fn in fns):
        raise ValueError(f"{name}: got {fns!r}; takes one or more placement functions")

    def placement(layout: Layout, cells: jax.Array) -> jax.Array:
        return reduce(combine, [fn(layout, cells) for fn in fns])

    placement.anchors = anchors_of(*fns)  # type: ignore[attr-defined]
    placement.rooms = max(map(rooms_of, fns))  # type: ignore[attr-defined]
    placement.__name__ = f"{name}({', '.join(map(name_of, fns))})"
    needs_quadrant = any(getattr(fn, "requires_quadrant", False) for fn in fns)
    return requires_quadrant(placement) if needs_quadrant else placement


def _check_anchor(to: str) -> str:
    if not isinstance(to, str):
        raise ValueError(f"to: got {to!r}; takes an object's name, such as 'box0'")
    return to


def _check_fraction(fraction: float) -> float:
    if not isinstance(fraction, int | float) or isinstance(fraction, bool) or not 0 < fraction <= 1:
        raise ValueError(f"fraction: got {fraction!r}; takes a number above 0, up to 1")
    return fraction


def _within_region(name: str, region: Region) -> PlacementFn:
    def placement(layout: Layout, cells: jax.Array) -> jax.Array:
        return _inside(layout, cells, region)

    placement.region = region  # type: ignore[attr-defined]
    placement.__name__ = name
    return placement


def _inside(layout: Layout, cells: jax.Array, region: Region) -> jax.Array:
    return within(layout.grid.size, cells, jnp.concatenate(region(layout.grid.size, layout.grid.cell, cells)))


def _has_quadrant(layout: Layout) -> jax.Array:
    return layout.plan.quadrant[2] > 0


def _or_anywhere(allowed: jax.Array, applies: jax.Array) -> jax.Array:
    return allowed | ~applies


def _distances(layout: Layout, points: jax.Array) -> jax.Array:
    """(G, G, n): from the centre that the object would have at every corner cell to n points (n, 2), in metres."""
    along = jnp.arange(layout.grid.size)[:, None] * layout.grid.cell + layout.offset
    dx = along[:, None, None, 0] - points[:, 0]
    dy = along[None, :, None, 1] - points[:, 1]
    return jnp.sqrt(dx**2 + dy**2)
