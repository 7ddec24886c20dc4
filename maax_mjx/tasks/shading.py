"""Places around a cylinder where boxes keep rays from it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.tasks.carrying import turned
from maax_mjx.wrappers.enclosure import Footprints

LONG, THIN, CUBE = 1.65, 0.15, 0.5
"""Metres of the boxes."""
GAP = 0.08
"""Metres between the cylinder and the nearest places of boxes."""
BEHIND = np.array([0.0, 0.25, 0.5, 0.8])
"""Metres by which places are further away than the nearest."""
TURNS = 48
"""Directions from the cylinder in which there are places."""
STANDS = np.array([0.0, np.pi / 2, -np.pi / 2])
"""Radians from the direction away from the cylinder to where the agent stands, seen from the box."""
BESIDE = 0.18
"""Metres from a box's face to the middle of an agent that takes hold there."""
ROOM, BODY = 0.02, 0.15
"""Metres that boxes in their places and the middles of agents beside them keep from others."""
EDGE, KEPT = 0.12, 0.28
"""Metres that boxes and agents' middles keep from the edges of the floor."""


class Places(NamedTuple):
    """Where boxes may go.

    Attributes:
        boxes: (m,) footprints there, whose x axes point away from the cylinder.
        out: (m,) radians of these.
        stops: (m, r) bool, the rays that end there.
        is_long: (m,) bool, whether it is for a long box.
    """

    boxes: Footprints
    out: np.ndarray
    stops: jax.Array
    is_long: np.ndarray


def places_around(middle: jax.Array, radius: jax.Array, starts: jax.Array) -> Places:
    """Returns the places around a cylinder.

    Args:
        middle: (2,) metres, of the cylinder.
        radius: () metres.
        starts: (r, 2) metres, where rays begin.
    """
    out = np.arange(TURNS) * (2 * np.pi / TURNS)
    is_long, behind, out = (x.reshape(-1) for x in np.meshgrid([False, True], BEHIND, out, indexing="ij"))
    half = np.where(is_long[:, None], [THIN / 2, LONG / 2], CUBE / 2)
    u = np.stack([np.cos(out), np.sin(out)], axis=1)
    centre = middle + u * (radius + GAP + behind + half[:, 0])[:, None]
    there = Footprints(centre, jnp.asarray(half), jnp.asarray(u))
    return Places(there, out, stopped(there, starts, middle), is_long)


def stopped(things: Footprints, starts: jax.Array, middle: jax.Array) -> jax.Array:
    """Returns which things stop which rays (r, 2) to a point (2,): (n, r) bool."""

    def one(thing: Footprints) -> jax.Array:
        back = -jnp.arctan2(thing.turn[1], thing.turn[0])
        from_, way = turned(starts - thing.centre, back), turned(middle - starts, back)
        way = jnp.where(jnp.abs(way) < 1e-6, 1e-6, way)
        ends = jnp.stack([(-thing.half - from_) / way, (thing.half - from_) / way])
        first, last = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        return (last > jnp.maximum(first, 0.0)) & (first < 1.0) & (thing.half > 0).all()

    return jax.vmap(one)(things)


def gains(places: Places, things: Footprints, starts: jax.Array, middle: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rays gained if boxes go to places (n, m), -inf where they do not fit; and those that only they stop now (n,)."""
    stops = stopped(things, starts, middle)
    # Rays that no other box stops.
    mine = (stops.sum(axis=0) - stops) == 0
    alone = (mine & stops).sum(axis=1)
    gain = mine.astype(jnp.float32) @ places.stops.T.astype(jnp.float32) - alone[:, None]
    fits = is_long(things)[:, None] == places.is_long
    return jnp.where(fits & (things.half > 0).all(axis=1)[:, None], gain, -jnp.inf), alone


def is_long(things: Footprints) -> jax.Array:
    """Which boxes are long: (...) bool."""
    return things.half.max(axis=-1) > CUBE


def free(places: Places, things: Footprints, floor: jax.Array) -> jax.Array:
    """Whether there is room for a box in a place and an agent beside it: (n, m, stands) bool."""
    there = places.boxes
    u = there.turn
    aside = jnp.stack([-u[:, 1], u[:, 0]], axis=1)
    grid = np.stack(np.meshgrid([-1.0, 1.0], np.linspace(-1, 1, 7), indexing="ij"), axis=-1).reshape(-1, 2)
    at = grid * there.half[:, None]
    points = there.centre[:, None] + at[..., :1] * u[:, None] + at[..., 1:] * aside[:, None]
    stands = jnp.stack([
        there.centre + (there.half[:, :1] + BESIDE) * u,
        there.centre + (there.half[:, 1:] + BESIDE) * aside,
        there.centre - (there.half[:, 1:] + BESIDE) * aside,
    ], axis=1)  # fmt: skip
    inside = jnp.minimum(points, floor - points).min(axis=(1, 2)) > EDGE
    inside = inside[:, None] & (jnp.minimum(stands, floor - stands).min(axis=2) > KEPT)

    def apart(thing: Footprints) -> jax.Array:
        one = jax.tree.map(lambda x: x[None], thing)
        return (one.clearance(points).min(axis=1) > ROOM)[:, None] & (one.clearance(stands) > BODY)

    close = ~jax.vmap(apart)(things)
    # By others than the box itself.
    return ((close.sum(axis=0) - close) == 0) & inside
