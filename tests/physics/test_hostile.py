"""Full force, held: no NaN reaches a user, and every fault is contained and counted."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.benchmarks.hostile import Seen, player

pytestmark = pytest.mark.slow


# Both gravities of play are in the range, so that one compiled program plays under either.
GRAVITY = (-50.0, -9.81)


@functools.cache
def compiled(impl, n_worlds, **fields):
    worlds = maax.Worlds(maax.make("standard", impl=impl, modules=[maax.WorldConstants(GRAVITY)], **fields), n_worlds)
    return worlds, player(worlds)


def play(impl, gravity, n_worlds, n_steps, held, **fields):
    """Bang-bang actions held for `held` steps: the counts, after checking that a user saw nothing bad."""
    worlds, run = compiled(impl, n_worlds, **fields)
    params = worlds.env.default_params.replace(gravity=gravity)
    states, seen = run(worlds.reset(seeds.key(0), params), Seen.nothing(), jnp.arange(n_steps), held)
    assert bool(seen.finite), "a NaN or infinity reached the user"
    assert bool(seen.inside), "an agent was left outside the arena"
    assert bool(seen.truncating), "a fault did not truncate its world"
    return states.totals()


@pytest.mark.parametrize(
    ("gravity", "held"),
    [
        (-9.81, 1),
        (-9.81, 20),
        (-9.81, 500),
        (-50.0, 20),
        (-50.0, 500),
    ],
)
def test_c_many_worlds(gravity, held):
    counts = play("c", gravity, 120, 500, held)
    assert counts["physics_fault"] == 0
    assert counts["contact_overflow"] == 0
    assert counts["layout_invalid"] == 0


def test_jax():
    few = {"n_hiders": 1, "n_seekers": 1, "n_boxes": 1, "n_ramps": 1}
    for held in (20, 150):
        counts = play("jax", -50.0, 8, 150, held, **few)
        assert counts["physics_fault"] == 0
        assert counts["contact_overflow"] == 0


def test_warp():
    pytest.importorskip("warp")
    for held in (20, 100):
        counts = play("warp", -50.0, 8, 100, held)
        assert counts["physics_fault"] == 0
        assert counts["contact_overflow"] == 0


@pytest.fixture(scope="module", params=["c", "warp"])
def four(request):
    """Four worlds of two agents and their first states, compiled once per engine."""
    if request.param == "warp":
        pytest.importorskip("warp")
    env = maax.make("standard", impl=request.param, scenario="empty", n_hiders=1, n_seekers=1, n_ramps=0)
    worlds = maax.Worlds(env, 4, donate=False)
    return worlds, worlds.reset(seeds.key(1))


@pytest.mark.parametrize("damage", ["nan", "outside", "high", "below"])
def test_a_fault_is_contained(four, damage):
    worlds, states = four
    env = worlds.env
    action = worlds.sample_action(seeds.key(2))
    joint = {"nan": 0, "outside": 0, "high": 2, "below": 2}[damage]
    value = {"nan": np.nan, "outside": 7.0, "high": 9.0, "below": -2.0}[damage]
    address = env.agents.qpos_ids[1][joint]
    hurt = states.replace(data=states.data.replace(qpos=states.data.qpos.at[2, address].set(value)))
    if damage == "nan":
        hurt = hurt.replace(data=hurt.data.replace(qvel=hurt.data.qvel.at[2, 0].set(0.0)))
    after, clean = worlds.step(hurt, action), worlds.step(states, action)
    np.testing.assert_array_equal(after.metrics["physics_fault"], [False, False, True, False])
    np.testing.assert_array_equal(after.truncated, [False, False, True, False])
    np.testing.assert_array_equal(after.counts["physics_fault"], [0, 0, 1, 0])
    assert int(after.step[2]) == 0, "the world was not regenerated"
    # Nothing of the trouble is left, such as the solver's starting point: the next episode begins as it was drawn.
    of_world = [data.replace(engine=()) for data in (states.upcoming.state.data, after.data)]
    drawn, begun = jax.tree.map(lambda x: x[2], of_world)
    jax.tree.map(np.testing.assert_array_equal, begun, drawn)
    assert not begun.qvel.any()
    assert not begun.qacc_warmstart.any()
    others = np.array([0, 1, 3])
    np.testing.assert_array_equal(after.data.qpos[others], clean.data.qpos[others])
    assert np.isfinite(after.data.qpos).all()
    for name in after.obs:
        assert np.isfinite(np.asarray(after.obs[name], float)).all()
