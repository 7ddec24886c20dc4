"""Shelter construction: its reward as MuJoCo's own rays have it, from starts that an oracle gives."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds, transfer_oracle
from helpers.plain_mujoco import in_plain_mujoco

import maax_mjx as maax
from maax_mjx.tasks import scenes, shading
from maax_mjx.tasks.carrying import footprints
from maax_mjx.training.opponents import SCRIPTED

N = 24


@functools.cache
def env_of():
    return maax.make("shelter", impl="c", observations="raw", n_bins=None, sees_cylinder=True)


@functools.cache
def placed():
    """Worlds as they are drawn; and with boxes beside the cylinder, as they lie and turned."""
    env, rng = env_of(), seeds.rng(0)
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(seeds.key(0), N))
    qpos, ids = np.array(states.data.qpos), env.base.modules["box"].qpos_ids
    middle, size = np.asarray(states.obs["static_cylinder_pos"])[:, 0], np.asarray(states.obs["static_cylinder_size"])
    for w in range(N):
        if w % 3 == 0:
            continue
        for i, angle in enumerate(rng.uniform(0, 2 * np.pi, 8)):
            away = size[w, 0, 0] / 2 + 0.9 + 0.02 * i
            at = np.clip(middle[w, :2] + away * np.array([np.cos(angle), np.sin(angle)]), 0.9, 5.1)
            qpos[w, ids[i]] = [*at, 0.25, rng.uniform(-np.pi, np.pi) if w % 3 == 2 else 0.0]
    data = jax.jit(jax.vmap(env.base.engine.pose))(states.world.fields, states.data.replace(qpos=qpos))
    return states.replace(data=data)


@functools.cache
def compiled():
    """The poses of a world's `qpos`, and which rays get to the cylinder."""
    env = env_of()
    layer = next(layer for layer in env.layers if isinstance(layer, maax.ShelterReward))
    return jax.jit(env.base.engine.pose), jax.jit(layer.reaching)


def reaching(env, state, w):
    """Which rays get to the cylinder in plain MuJoCo."""
    model, data = in_plain_mujoco(env, state, w)
    mujoco.mj_forward(model, data)
    cylinder, met = model.geom("static_cylinder0").id, np.zeros(1, np.int32)
    hits = []
    for start in transfer_oracle.shelter_starts():
        to = data.geom_xpos[cylinder] - start
        mujoco.mj_ray(model, data, start, to / np.linalg.norm(to), None, 1, -1, met)
        hits.append(met[0] == cylinder)
    return np.array(hits)


@pytest.mark.slow
def test_the_reward_is_that_of_mujocos_rays():
    """One ray in a hundred may pass an edge by another side of it."""
    env, keys = env_of(), jax.random.split(seeds.key(1), N)
    state = jax.jit(jax.vmap(env.step))(placed(), jax.jit(jax.vmap(env.sample_action))(keys))
    points = [transfer_oracle.shelter_reward(reaching(env, state, w)) for w in range(N)]
    np.testing.assert_allclose(state.reward[:, 0], points, atol=0.0011)
    assert (np.abs(state.reward[:, 0] - np.array(points)) < 1e-6).mean() > 0.9
    assert -0.1 <= min(points) < max(points) < -0.001


def test_boxes_around_the_cylinder_keep_rays_away():
    """Eight in a ring stop a third of those that come in the open, and more where long boxes stand across."""
    env, state = env_of(), jax.jit(lambda states: jax.tree.map(lambda x: x[0], states))(placed())
    middle, radius = np.asarray(state.obs["static_cylinder_pos"])[0], float(state.obs["static_cylinder_size"][0, 0]) / 2
    pose, reaching = compiled()

    def share(away):
        qpos, angles = np.array(state.data.qpos), np.arange(8) * np.pi / 4
        ring = middle[:2] + away * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        qpos[env.base.modules["box"].qpos_ids] = np.column_stack([ring, np.full(8, 0.25), angles + np.pi / 2])
        data = pose(state.world.fields, state.data.replace(qpos=qpos))
        return float(reaching(state.replace(data=data)).mean())

    assert share(50.0) > 0.9
    # From 1.3 m, five cubes hide 1.9 of 6.3 radians, and three long boxes that point at the middle another 0.35.
    assert share(radius + 0.3) < 0.7


def test_worlds_are_drawn_as_published():
    env = env_of()
    states = maax.Worlds(env, 1000).reset(seeds.key(2))
    obs = {name: np.asarray(value) for name, value in states.obs.items()}
    assert np.asarray(states.world.valid).mean() > 0.97
    diameter = obs["static_cylinder_size"][:, 0, 0]
    assert 1.5 <= diameter.min() < 1.52
    assert 1.98 < diameter.max() <= 2.0
    cells = np.ceil(diameter / 0.2 - 1e-5).astype(int)
    lowest = np.round((obs["static_cylinder_pos"][:, 0, :2] - 0.1 * cells[:, None]) / 0.2).astype(int)
    for s in (8, 9, 10):
        first, last = transfer_oracle.middle_cells(0.7, s)
        np.testing.assert_array_equal(np.unique(lowest[cells == s]), np.arange(first, last + 1))
    sizes = np.sort(np.asarray(jax.vmap(env.base.modules["box"].extents_of)(states.world))[:, :, :2], axis=2)
    long = np.isclose(sizes, [0.15, 1.65], atol=1e-3).all(axis=2)
    np.testing.assert_array_equal(long.sum(axis=1), 3)
    np.testing.assert_allclose(sizes[~long], 0.5, atol=1e-5)


def test_only_the_lidar_tells_of_the_cylinder():
    env = maax.make("shelter", impl="c")
    assert not any("cylinder" in name for name in env.observed)
    assert "lidar" in env.observed
    assert any("cylinder" in name for name in env_of().observed)


@pytest.mark.slow
def test_rays_go_to_every_cylinder_and_to_none_that_is_absent():
    base = maax.Base(1, impl="c")
    for module in (maax.WallScenarios("empty"), maax.StaticCylinders((0, 2), 0.5), maax.Agents(1)):
        base.add_module(module)
    env = maax.ShelterReward(base, rays_per_side=5, scale=1.0)
    reset, step, reaching, sample = (
        jax.jit(jax.vmap(function)) for function in (env.reset, env.step, env.reaching, env.sample_action)
    )
    states = reset(jax.random.split(seeds.key(3), 12))
    reach = np.asarray(reaching(states))
    there = np.asarray(states.world.active["static_cylinder"])
    assert reach.shape == (12, 20, 2)
    assert not reach[~np.broadcast_to(there[:, None], reach.shape)].any()
    assert reach[np.broadcast_to(there[:, None], reach.shape)].mean() > 0.5
    after = step(states, sample(jax.random.split(seeds.key(4), 12)))
    np.testing.assert_allclose(after.reward[:, 0], -np.asarray(reaching(after)).sum(axis=(1, 2)))


@pytest.mark.slow
def test_a_script_shelters_the_cylinder(fast_programs):
    """With forces, in the published time; see `docs/games.md` for how many rays are left of how many."""
    scene = scenes.shelter("c")
    worlds = maax.Worlds(scene.env, 16)
    keep = ("reward",)
    _, kept = worlds.rollout(worlds.reset(seeds.key(12)), lambda state, key: scene.act(state), scene.n_steps, keep=keep)
    rays = -1000 * np.asarray(kept["reward"])[..., 0]
    assert rays[-1].mean() < 0.4 * rays[0].mean()
    assert (rays[-1] <= 0.5 * rays[0]).mean() > 0.7
    with pytest.raises(ValueError, match="shelter: got a game without ShelterReward"):
        SCRIPTED["shelter"].on(maax.make("blueprint", impl="c"))


def test_the_script_knows_which_rays_boxes_stop():
    """As the rays of the physics, but for boxes that lie in the cylinder, and rays along edges."""
    env, states = env_of(), placed()
    layer = next(layer for layer in env.layers if isinstance(layer, maax.ShelterReward))
    # Agents stop rays, too.
    qpos = states.data.qpos.at[:, env.base.agents.qpos_ids[0, 2]].add(20.0)
    states = states.replace(data=jax.vmap(env.base.engine.pose)(states.world.fields, states.data.replace(qpos=qpos)))

    def stopped(state):
        middle = state.data.geom_xpos[layer.cylinders.geom_ids[0], :2]
        return shading.stopped(footprints(state, env, ("box",)), jnp.asarray(layer.starts[:, :2]), middle).any(axis=0)

    reach = jax.jit(jax.vmap(layer.reaching))(states)[..., 0]
    assert (reach != jax.jit(jax.vmap(stopped))(states)).mean() > 0.97
    assert 0.1 < reach.mean() < 0.9


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="without StaticCylinders; ShelterReward takes one with StaticCylinders"):
        maax.ShelterReward(maax.make("standard", impl="c"))
    with pytest.raises(ValueError, match="takes 'warp' or 'c' there"):
        maax.make("shelter", impl="jax")
    for field, value in {"cylinder_middle": 0.0, "cylinder_diameter": 0.0, "task.rays_per_side": 0}.items():
        with pytest.raises(ValueError, match=f"{field}: got {value}"):
            maax.make("shelter", **{field: value})
