"""What runs where: lowering for all platforms, and the choice of an engine."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.physics import select

PLATFORMS = ("cpu", "cuda", "tpu")


@pytest.fixture(scope="module")
def env_jax():
    """One of each on MJX's JAX physics."""
    few = {"n_hiders": 1, "n_seekers": 1, "n_boxes": 1, "n_ramps": 1}
    return maax.make("standard", impl="jax", scenario="empty", **few)


@pytest.mark.slow
def test_reset_and_step_are_exported_for_all_platforms(env_jax):
    """Nothing in them is bound to the platform that they are traced on. No TPU was at hand to run it."""
    key = seeds.key(0)
    reset = jax.export.export(jax.jit(env_jax.reset), platforms=PLATFORMS)(key)
    state = jax.eval_shape(env_jax.reset, key)
    action = {"move": jax.ShapeDtypeStruct((2, 3), jnp.float32)}
    step = jax.export.export(jax.jit(env_jax.step), platforms=PLATFORMS)(state, action)
    assert reset.platforms == step.platforms == PLATFORMS
    np.testing.assert_array_equal(reset.call(key).data.qpos, jax.jit(env_jax.reset)(key).data.qpos)


@pytest.mark.slow
def test_a_batch_is_exported_for_all_platforms(env_jax):
    worlds = maax.Worlds(env_jax, 4)
    params = jax.tree.map(lambda x: jnp.broadcast_to(x, (4, 2)), env_jax.default_params)
    states = jax.eval_shape(worlds.reset_fn, seeds.key(0), params, jnp.asarray(False))
    action = {"move": jax.ShapeDtypeStruct((4, 2, 3), jnp.float32)}
    assert jax.export.export(jax.jit(worlds.step_fn), platforms=PLATFORMS)(states, action).platforms == PLATFORMS


def test_warp_without_its_library(monkeypatch):
    monkeypatch.setattr(select, "find_spec", lambda name: None)
    with pytest.raises(maax.MissingLibraryError, match=r"impl: got 'warp'.*\.\[cuda\]"):
        maax.make("standard", impl="warp")


@pytest.mark.parametrize(
    ("backend", "version", "warp", "best"),
    [
        ("cpu", "<unknown>", True, "c"),
        ("gpu", "PJRT C API\ncuda 13000", True, "warp"),
        ("gpu", "PJRT C API\ncuda 13000", False, "jax"),
        ("gpu", "PJRT C API\nrocm 70000", True, "jax"),
        ("tpu", "PJRT C API\nTFRT TPU v6 lite", True, "jax"),
    ],
)
def test_auto(monkeypatch, backend, version, warp, best):
    class Device:
        class client:
            platform_version = version

    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    monkeypatch.setattr(jax, "local_devices", lambda: [Device])
    monkeypatch.setattr(select, "find_spec", lambda name: object() if warp else None)
    assert select.best_impl() == best


def test_c_is_refused_where_jax_computes_elsewhere(env_c, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with pytest.raises(ValueError, match=r"impl: got 'c' where JAX computes on gpu"):
        select.make_engine("c", env_c.model, env_c.overlay, 16, 0)
