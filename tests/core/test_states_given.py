"""States and actions that do not fit an environment are refused by a sentence, in `env.step`, jitted and in batches."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import pytest
from helpers import seeds

import maax_mjx as maax


@pytest.fixture(scope="module")
def tag():
    return maax.make("tag", impl="c", n_boxes=1, n_ramps=0, observations="raw")


@pytest.fixture(scope="module")
def state(tag):
    return tag.reset(seeds.key(0))


@pytest.fixture(scope="module")
def other_state():
    """A state of the same agents, box and room without the game's memory."""
    teams = {"n_hiders": 4, "n_seekers": 0, "hider_placement": "uniform"}
    return maax.make("standard", impl="c", scenario="empty", n_boxes=1, n_ramps=0, **teams).reset(seeds.key(0))


def batch_of(state):
    return jax.tree.map(lambda x: jnp.stack([x, x]), state)


def test_states_of_a_batch_are_refused(tag, state):
    action = tag.sample_action(seeds.key(1))
    for step in (tag.step, maax.jitted(tag)[1]):
        with pytest.raises(ValueError, match=r"state: got a batch of 2 worlds; takes one world: use jax\.vmap"):
            step(batch_of(state), action)


def test_states_of_another_game_are_refused(tag, state, other_state):
    action = tag.sample_action(seeds.key(1))
    for step in (tag.step, maax.jitted(tag)[1]):
        with pytest.raises(ValueError, match=r"states of another environment: state\.mechanics\.\S+ has nothing"):
            step(other_state, action)
    worlds = maax.Worlds(tag, 2)
    states = worlds.states_shape
    with pytest.raises(ValueError, match=r"states of another environment: state\.mechanics\.\S+ has nothing"):
        worlds.step(states.replace(mechanics={}), worlds.sample_action(seeds.key(1)))


def test_what_is_no_state_is_refused(tag, state):
    action = tag.sample_action(seeds.key(1))
    with pytest.raises(ValueError, match="state: got dict; takes a State, as reset and step give it"):
        tag.step({"qpos": 1}, action)
    with pytest.raises(ValueError, match=r"action: got an array; takes a dict with \['move'\]"):
        tag.step(state, action["move"])


@pytest.mark.slow
def test_a_step_outside_of_traced_code_is_compiled_once(tag, state):
    tag.step(tag.step(state, tag.sample_action(seeds.key(1))), tag.sample_action(seeds.key(2)))
    assert tag._traced_advance._cache_size() == 1
    with jax.disable_jit():
        eager = tag.step(state, tag.sample_action(seeds.key(1)))
    compiled = tag.step(state, tag.sample_action(seeds.key(1)))
    assert jnp.allclose(eager.data.qpos, compiled.data.qpos, atol=1e-5)
