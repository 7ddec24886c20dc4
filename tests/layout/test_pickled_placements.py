"""Placements that were made by a factory can be pickled, and with them environments and their configs."""

from __future__ import annotations

import pickle

import jax.numpy as jnp
import numpy as np
import pytest

import maax_mjx as maax
from maax_mjx.layout.layout import Layout, name_of
from maax_mjx.layout.placement import anchors_of, region_of

MADE = {
    "at": maax.at_placement(1.0, 2.0),
    "middle": maax.middle_placement(0.4),
    "separation": maax.separation_placement(1.5),
    "proximity": maax.proximity_placement(1.0, to="box0"),
    "published proximity": maax.published_proximity_placement(1.0, to="box0"),
    "room": maax.room_placement(0),
    "published room": maax.published_room_placement(0),
    "all": maax.all_of(maax.middle_placement(0.7), maax.proximity_placement(radius=2.0, to="box0")),
    "any": maax.any_of(maax.uniform_placement, maax.quad_placement),
}
MARKS = ("requires_quadrant", "inside_quadrant")


def a_layout():
    layout = Layout.empty(20, 6.0)
    rooms = {"rooms": jnp.array([[2, 3, 9, 12]], jnp.int32), "room_mask": jnp.ones(1, bool)}
    plan = layout.plan.replace(quadrant=jnp.array([8, 8, 20, 20], jnp.int32), **rooms)
    return layout.replace(plan=plan, objects={"box0": jnp.array([2.0, 2.5, 1.0])})


@pytest.mark.parametrize("name", MADE)
def test_a_pickled_placement_allows_the_same_places(name):
    placement = MADE[name]
    twin = pickle.loads(pickle.dumps(placement))
    assert name_of(twin) == name_of(placement)
    assert anchors_of(twin) == anchors_of(placement)
    assert (region_of(twin) is None) == (region_of(placement) is None)
    assert [getattr(twin, mark, None) for mark in MARKS] == [getattr(placement, mark, None) for mark in MARKS]
    weights, again = (np.asarray(fn(a_layout(), jnp.array([2, 2]))) for fn in (placement, twin))
    assert weights.sum() > 0
    np.testing.assert_array_equal(again, weights)


def test_an_environment_with_one_can_be_pickled():
    env = maax.Base(2, impl="c")
    for module in (maax.WallScenarios("empty"), maax.Boxes(1), maax.Agents(2, MADE["proximity"])):
        env.add_module(module)
    twin = pickle.loads(pickle.dumps(env))
    assert list(twin.modules) == list(env.modules)


def test_what_cannot_be_pickled_is_named():
    env = maax.make("tag", impl="c", inside={"Tag": lambda env: env})
    with pytest.raises(ValueError, match=r"env: got <tag\(.*which cannot be pickled .*takes functions and classes"):
        pickle.dumps(env)
    with pytest.raises(ValueError, match=r"worlds: got them to be pickled or copied.*takes their environment"):
        pickle.dumps(maax.Worlds(maax.make("tag", impl="c"), 2))
