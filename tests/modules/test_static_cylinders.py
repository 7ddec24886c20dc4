"""Cylinders that are fixed to the floor, beside some that can be pushed."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from helpers import seeds
from scipy import stats

import maax_mjx as maax
from maax_mjx.modules import StaticCylinders

N, FEW, RADIUS, TOL, P_MIN = 1_000, 100, 0.15, 1e-4, 1e-3
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose


def build(*modules):
    env = maax.Base(2, impl="c")
    for module in (maax.WallScenarios("empty"), maax.Agents(2), *modules):
        env.add_module(module)
    return env


@pytest.fixture(scope="module")
def env():
    return build(
        StaticCylinders((1, 2), (0.3, 0.9), (0.2, 0.6), friction=(0.2, 1.0)),
        maax.Cylinders((0, 1), (0.3, 0.5), per_object=False),
    )


@pytest.fixture(scope="module")
def drawn(env, batch_reset):
    return jax.device_get(batch_reset(env, jax.random.split(seeds.key(0), N)))


def rows(env, states, name, ids):
    """(N, n, ...) of a model field that worlds differ in."""
    there = list(env.overlay[name])
    return np.asarray(states.world.fields[name])[:, [there.index(i) for i in ids]]


def uniform(x, low, high):
    return stats.kstest(x, "uniform", (low, high - low)).pvalue > P_MIN


@pytest.mark.slow
def test_sizes_frictions_and_places(env, drawn):
    ids, there = env.modules["static_cylinder"].geom_ids, drawn.world.active["static_cylinder"]
    assert set(there.sum(axis=1)) == {1, 2}
    radius, half = rows(env, drawn, "geom_size", ids)[..., :2].transpose(2, 0, 1)
    friction = rows(env, drawn, "geom_friction", ids)[..., 0]
    assert uniform(2 * radius[:, 0], 0.3, 0.9)
    assert uniform(2 * half[:, 0], 0.2, 0.6)
    assert uniform(friction[:, 0], 0.2, 1.0)
    assert abs(stats.spearmanr(radius[:, 0], radius[:, 1]).statistic) < 4 / np.sqrt(N), "each draws its own"
    centre = drawn.data.geom_xpos[:, ids]
    close(centre[there][:, 2], half[there], atol=1e-6)
    assert (centre[~there][:, 2] < -1).all()
    agents = drawn.data.qpos[:, env.agents.qpos_ids[:, :2]]
    apart = np.linalg.norm(agents[:, :, None] - centre[:, None, :, :2], axis=-1) - RADIUS - radius[:, None]
    assert apart[np.broadcast_to(there[:, None], apart.shape)].min() > -TOL
    obs = drawn.obs
    equal(obs["static_cylinder_mask"], there)
    close(obs["static_cylinder_pos"], np.where(there[..., None], centre, 0))
    size = 2 * np.stack([radius, radius, half], axis=-1)
    close(obs["static_cylinder_size"], np.where(there[..., None], size, 0), atol=1e-6)
    assert "static_cylinder_obs" not in obs
    assert obs["cylinder_obs"].shape == (N, 1, 9)
    assert obs["cylinder_size"].shape == (N, 1, 3)


def test_only_the_movable_ones_are_movable(env):
    assert [module.name for module in env.movables] == ["agent", "cylinder"]
    with pytest.raises(ValueError, match=r"objects: got 'static_cylinder'; did you mean 'cylinder'"):
        env.objects(["static_cylinder"])
    names = [env.model.body(i).name for i in range(env.model.nbody)]
    assert [name for name in names if "cylinder" in name] == ["cylinder0"]


def test_they_stand_fast(env, batch_reset, batch_step):
    """Agents at full force come up to them, and no further."""
    params = env.default_params.replace(static_cylinder_height=0.6, n_cylinders=0)
    states = batch_reset(env, jax.random.split(seeds.key(1), FEW), params)
    ids = env.modules["static_cylinder"].geom_ids
    start = np.asarray(states.data.geom_xpos)[:, ids]
    radius = rows(env, states, "geom_size", ids)[:, 0, 0]
    nearest = np.full(FEW, np.inf)
    for _ in range(200):
        way = start[:, :1, :2] - np.asarray(states.data.qpos)[:, env.agents.qpos_ids[:, :2]]
        move = np.zeros((FEW, 2, 3), np.float32)
        move[..., :2] = way / np.abs(way).max(axis=-1, keepdims=True).clip(1e-6)
        states = batch_step(env, states, {"move": move})
        nearest = np.minimum(nearest, np.linalg.norm(way, axis=-1).min(axis=1) - RADIUS - radius)
    assert nearest.min() > -RADIUS, "the centre of an agent is inside"
    # At 9 m/s a step is 45 mm, and another agent may push from behind.
    assert np.quantile(nearest, 0.1) > -0.1, "at impact"
    assert np.median(nearest) < 0.02, "they get there"
    close(np.asarray(states.data.geom_xpos)[:, ids], start, atol=1e-6)


def test_fixed_sizes_are_compiled(batch_reset):
    env = build(StaticCylinders(2, 0.4, 0.3, friction=0.2))
    geom = env.model.geom("static_cylinder1")
    close(geom.size[:2], [0.2, 0.15])
    close(geom.friction[0], 0.2)
    assert "geom_friction" not in env.overlay
    obs = batch_reset(env, jax.random.split(seeds.key(0), 4)).obs
    assert "static_cylinder_size" not in obs
    close(obs["static_cylinder_pos"][..., 2], 0.15, atol=1e-6)


def test_sizes_that_are_refused():
    with pytest.raises(ValueError, match="diameter: got 0; takes a positive number"):
        StaticCylinders(1, diameter=0)
    with pytest.raises(ValueError, match="height: got -1"):
        StaticCylinders(1, height=-1)
    with pytest.raises(ValueError, match="n_static_cylinders: got -1"):
        StaticCylinders(-1)
