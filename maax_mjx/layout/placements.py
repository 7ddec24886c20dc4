"""Placement functions by name, as configs and commands take them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial

from maax_mjx.common.checks import check_choice, check_new_name
from maax_mjx.layout.layout import PlacementFn
from maax_mjx.layout.placement import (
    centre_placement,
    middle_placement,
    name_of,
    outside_quad_placement,
    published_outside_quad_placement,
    published_quad_placement,
    published_room_placement,
    published_rooms_in_turn_placement,
    published_uniform_placement,
    quad_placement,
    room_placement,
    rooms_in_turn_placement,
    uniform_placement,
)

MIDDLE = 0.5
"""Share of the floor's edge, of the square that is called "middle"."""
ROOMS = {"room": room_placement, "published_room": published_room_placement}
"""Placements in a room, by what stands before its number."""


def _or_anywhere(fn: PlacementFn) -> PlacementFn:
    """The same placement, which an environment without a quadrant takes, too."""
    placement = partial(fn)
    placement.__name__ = name_of(fn)  # type: ignore[attr-defined]
    placement.inside_quadrant = getattr(fn, "inside_quadrant", False)  # type: ignore[attr-defined]
    return placement


_PLACEMENTS: dict[str, PlacementFn] = {
    "uniform": uniform_placement,
    "centre": centre_placement,
    "middle": middle_placement(MIDDLE),
    "quad": _or_anywhere(quad_placement),
    "rooms_in_turn": rooms_in_turn_placement,
    "outside_quad": _or_anywhere(outside_quad_placement),
    "published_uniform": published_uniform_placement,
    "published_quad": _or_anywhere(published_quad_placement),
    "published_outside_quad": _or_anywhere(published_outside_quad_placement),
    "published_rooms_in_turn": published_rooms_in_turn_placement,
}


def placement_names() -> list[str]:
    """The names that `placement_by_name` takes, "room0", "room1", ... apart."""
    return sorted(_PLACEMENTS)


def placement_by_name(name: str, argument: str = "placement", also: Sequence[str] = ()) -> PlacementFn:
    """A placement function by its name.

    "uniform" is anywhere, "centre" in the middle to the cell, "middle" in the central square of half the floor's edge,
    "quad" and "outside_quad" in and outside the quadrant, both anywhere in an environment without one, "room0",
    "room1", ... in that room (see `room_placement`), "rooms_in_turn" in one of the rooms with fewest objects (see
    `rooms_in_turn_placement`); those named "published_..." have the ranges of cells of OpenAI's code. Others are those
    of `register_placement`.

    Args:
        name: of the placement.
        argument: what the name was passed as, for the message.
        also: names that the caller takes besides, for the message.

    Raises:
        ValueError: an unknown name, with the nearest ones.
    """
    if isinstance(name, str) and name not in _PLACEMENTS and (room := _room_of(name)):
        return ROOMS[room[1]](int(room[2]))
    return _PLACEMENTS[check_choice(argument, name, [*_PLACEMENTS, "room0", "room1", *also])]


def register_placement(name: str, placement_fn: PlacementFn) -> None:
    """Gives a placement function of your own a name, which the configs of games then take.

    Example:
        ```python
        def left_half(layout, cells):
            g = layout.grid.size
            return jnp.broadcast_to((jnp.arange(g) + cells[0] <= g // 2)[:, None], (g, g))

        register_placement("left_half", left_half)
        env = maax.make("hide_and_seek", seeker_placement="left_half")
        ```

    Args:
        name: a new one, and not "room0", "room1", ...
        placement_fn: `(layout, cells) -> weights`.

    Raises:
        ValueError: a name that is taken, or what is not a function.
    """
    check_new_name(name, _PLACEMENTS, placement_fn)
    if _room_of(name):
        raise ValueError(f"name: got {name!r}; takes a name that is not of a room")
    if not callable(placement_fn):
        raise ValueError(f"placement_fn: got {placement_fn!r}; takes a function (layout, cells) -> weights")
    _PLACEMENTS[name] = placement_fn


def _room_of(name: str) -> re.Match[str] | None:
    return re.fullmatch(rf"({'|'.join(ROOMS)})([0-9]+)", name)
