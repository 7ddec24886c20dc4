"""Construction from a blueprint: rewards and ends as an oracle has them that was written without looking at ours."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds, transfer_oracle
from scipy.spatial.transform import Rotation

import maax_mjx as maax
from maax_mjx.common.runtime import quick_compilation
from maax_mjx.layout import published_middle_placement
from maax_mjx.tasks import scenes
from maax_mjx.wrappers.blueprint import box_corners

N = 48
CORNERS = np.array([[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]]) / 4


@functools.cache
def env_of():
    return maax.make("blueprint", impl="c", n_boxes=(3, 5), n_sites=(1, 3), observations="raw", n_bins=None)


@functools.cache
def placed():
    """Worlds with boxes on their sites: as they are to be, turned by quarters, a little off, too far, or anywhere."""
    env, rng = env_of(), seeds.rng(0)
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), N))
    qpos = np.array(states.data.qpos)
    ids = env.base.modules["box"].qpos_ids
    sites, there = np.asarray(states.world.sites["construction_site"]), states.world.active
    for w in range(N):
        kind = w % 4
        order = rng.permutation(np.flatnonzero(np.asarray(there["box"][w])))
        for site in np.flatnonzero(np.asarray(there["construction_site"][w])):
            off = {0: 0.0, 1: 0.03, 2: 0.12, 3: 1.0}[kind] * np.array([1.0, 0.0])
            turn = rng.integers(4) * np.pi / 2 + (0.1 if kind == 1 else 0.0)
            qpos[w, ids[order[site]]] = [*(sites[w, site, :2] + off), 0.25, turn]
    data = jax.jit(jax.vmap(env.base.engine.pose))(states.world.fields, states.data.replace(qpos=qpos))
    return states.replace(data=data)


def seen(state, w):
    """Centres and corners of a world's boxes and sites, by SciPy and from the state alone."""
    env = env_of()
    boxes, active = env.base.modules["box"], {k: np.asarray(v[w]) for k, v in state.world.active.items()}
    at = np.asarray(state.data.xpos)[w, boxes.body_ids][active["box"]]
    turns = Rotation.from_quat(np.asarray(state.data.xquat)[w, boxes.body_ids][active["box"]], scalar_first=True)
    sites = np.asarray(state.world.sites["construction_site"])[w][active["construction_site"]]
    corners = np.stack([at + turns.apply(np.tile(corner, (len(at), 1))) for corner in CORNERS], axis=1)
    return at, corners, sites, sites[:, None] + CORNERS


def test_boxes_on_their_sites_end_the_episode_and_pay():
    env, states = env_of(), placed()
    still = {"move": jnp.zeros((N, 1, 3)), "lock": jnp.zeros((N, 1), jnp.int8), "grab": jnp.zeros((N, 1), jnp.int8)}
    after = jax.jit(jax.vmap(env.step))(states, still)
    ends = np.zeros(N, bool)
    for w in range(N):
        boxes, corners, sites, site_corners = seen(after, w)
        ends[w] = transfer_oracle.blueprint_done(boxes, corners, sites, site_corners)
        wanted = transfer_oracle.blueprint_dense(corners, site_corners)
        wanted += transfer_oracle.blueprint_completed(len(sites)) if ends[w] else 0.0
        np.testing.assert_allclose(after.reward[w, 0], wanted, atol=1e-4)
    np.testing.assert_array_equal(after.terminated, ends)
    np.testing.assert_array_equal(ends[0::4], True)
    assert ends[1::4].any()
    assert not ends[2::4].any()
    assert not ends[3::4].any()


def test_corners_are_where_the_boxes_are():
    env, states = env_of(), placed()
    found = jax.jit(jax.vmap(lambda state: box_corners(env.base.modules["box"], state)))(states)
    for w in range(0, N, 7):
        there = np.asarray(states.world.active["box"][w])
        np.testing.assert_allclose(np.asarray(found[w])[there], seen(states, w)[1], atol=1e-5)
    observing = maax.BoxCorners(env)
    observed = jax.vmap(observing.observation)(states)["box_corner_pos"]
    there = np.asarray(states.world.active["box"])
    np.testing.assert_allclose(np.asarray(observed)[there], np.asarray(found)[there], atol=1e-6)
    assert not np.asarray(observed)[~there].any()
    assert (~there).any()
    assert maax.SplitObservations(observing).observation_space["box_corner_pos"].shape == (1, 5, 4, 3)


@pytest.mark.slow
def test_sites_are_where_the_published_placement_puts_them():
    """Nowhere else, and everywhere there."""
    for share in (0.25, 0.7, 0.85, 1.0):
        for cells in (1, 3, 8, 10):
            low, high = published_middle_placement(share).region(30, jnp.asarray(0.2), jnp.full(2, cells))
            assert (int(low[0]), int(high[0]) - cells) == transfer_oracle.middle_cells(share, cells)
    env = maax.make("blueprint", impl="c", n_boxes=1, n_sites=1)
    states = maax.Worlds(env, 1500).reset(seeds.key(3))
    lowest = np.round((np.asarray(states.world.sites["construction_site"])[:, 0, :2] - 0.3) / 0.2).astype(int)
    first, last = transfer_oracle.middle_cells(0.85, 3)
    np.testing.assert_array_equal(np.unique(lowest[:, 0]), np.arange(first, last + 1))
    np.testing.assert_array_equal(np.unique(lowest[:, 1]), np.arange(first, last + 1))
    assert np.asarray(states.world.valid).all()


@pytest.mark.slow
def test_a_scripted_agent_builds(fast_programs):
    """All sites are full before the end in three of eight worlds or more; it was four in five of 128."""
    scene = scenes.blueprint("c")

    def play(key):
        def step(carry, _):
            state, done = carry
            state = scene.env.step(state, scene.act(state))
            return (state, done | state.terminated), None

        state = scene.reset(key)
        return jax.lax.scan(step, (state, jnp.zeros((), bool)), length=scene.n_steps)[0][1]

    done = jax.jit(jax.vmap(play), compiler_options=quick_compilation(1))(jax.random.split(seeds.key(4), 8))
    assert np.asarray(done).sum() >= 3


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="without ConstructionSites; BlueprintReward takes one with Con"):
        maax.BlueprintReward(maax.make("standard", impl="c"))
    for field, value in {"n_sites": 0, "site_middle": 0.0, "task.radius": 0.0, "task.steepness": 1.0}.items():
        with pytest.raises(ValueError, match=f"{field}: got {value}"):
            maax.make("blueprint", **{field: value})
    with pytest.raises(ValueError, match=r"n_sites: got \(2, 9\) with 8 boxes to fill them; takes as many at most"):
        maax.make("blueprint", n_sites=(2, 9))
    with pytest.raises(
        ValueError, match=r"n_sites: got 4 with site_middle=0.05, where 1 fit beside each other; takes as"
    ):
        maax.make("blueprint", impl="c", n_sites=4, site_middle=0.05)
