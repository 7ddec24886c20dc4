"""Shared, compiled once per session: environments and their jitted functions."""

from __future__ import annotations

import contextlib
import gc
import os
from pathlib import Path

from helpers.xla_flags import quick

# In the environment, not jax.config, so that the processes that tests start compile alike and share what they compile.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {quick()}"
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(Path(__file__).parent.parent / ".jax_cache")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.2"
os.environ["MAAX_XLA_LEVEL"] = "0"
# Where in the code an operation came from: a tenth of the time from a function to its program.
os.environ["JAX_TRACEBACK_IN_LOCATIONS_LIMIT"] = "0"

import maax_mjx as maax  # isort: skip


import jax
import pytest
from hypothesis import settings

from maax_mjx.tasks import registry

with contextlib.suppress(ImportError):
    import warp

    # Warp's kernels for the CPU: their compilation in two thirds of the time.
    warp.config.optimization_level = 0
# Tracing makes many small objects, which live on: looking for garbage among them took a tenth of the time.
gc.set_threshold(50_000, 10, 10)
settings.register_profile("maax", deadline=None, max_examples=25)
settings.load_profile("maax")

LONGEST = (
    "test_readme", "test_notebooks", "test_env", "test_check_env", "test_hostile", "test_physics", "test_games",
    "test_worlds", "test_viewer", "test_rollouts", "test_devices", "test_placement", "test_full_config",
)  # fmt: skip
"""Files that take longest: begun first, so that no worker is left with one while the other has nothing to do."""


def pytest_configure(config):
    # Else xdist's loadfile begins with the files of most tests.
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    order = {name: i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


@pytest.fixture
def fast_programs(monkeypatch):
    """For tests that compute more than they compile: programs of `Worlds`, and of `quick_compilation(1)`, run fast."""
    monkeypatch.setenv("MAAX_XLA_LEVEL", "1")


@pytest.fixture
def little_garbage():
    """What is there already is not looked through by every `gc.collect`, which takes a second and more else."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture
def made_once(monkeypatch):
    """Games of equal configs are one environment, whoever makes them: commands in a row trace it once."""
    task, made = registry._task, {}

    def remembering(name):
        def build(config):
            if any(getattr(config, field, ()) for field in ("modules", "inside", "outside")):
                return task(name).build(config)  # to which more is added
            key = name, repr(config)
            if key not in made:
                made[key] = task(name).build(config)
            return made[key]

        return registry.Task(build, task(name).config)

    monkeypatch.setattr(registry, "_task", remembering)


@pytest.fixture(scope="session")
def env_c():
    """M on the C engine."""
    return maax.make("standard", impl="c")


@pytest.fixture(scope="session")
def env_jax():
    """M on MJX's JAX physics."""
    return maax.make("standard", impl="jax")


@pytest.fixture(scope="session")
def env_warp():
    """M on MJX-Warp."""
    pytest.importorskip("warp")
    return maax.make("standard", impl="warp")


@pytest.fixture(scope="session")
def env_ranges():
    """Like M on the C engine, with 0 to 3 boxes and 0 to 2 ramps."""
    return maax.make("standard", impl="c", n_boxes=(0, 3), n_ramps=(0, 2))


@pytest.fixture(scope="session")
def batch_reset():
    """`batch_reset(env, keys, params=None)`: jitted, vmapped reset, compiled once per environment."""
    compiled = {}

    def reset(env, keys, params=None):
        if id(env) not in compiled:
            compiled[id(env)] = (env, jax.jit(jax.vmap(env.reset, in_axes=(0, None))))
        return compiled[id(env)][1](keys, env.default_params if params is None else params)

    return reset


@pytest.fixture(scope="session")
def batch_step():
    """`batch_step(env, states, action)`: jitted, vmapped step, compiled once per environment."""
    compiled = {}

    def step(env, states, action):
        if id(env) not in compiled:
            compiled[id(env)] = (env, jax.jit(jax.vmap(env.step)))
        return compiled[id(env)][1](states, action)

    return step
