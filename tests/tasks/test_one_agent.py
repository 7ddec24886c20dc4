"""A single agent: everything about others is empty, and all modes work."""

from __future__ import annotations

from itertools import product

import jax
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.tasks.hide_and_seek import GrabConfig, LidarConfig, LockConfig

MODES = [("raw", "self"), ("split", "self"), ("split", "team"), ("flat", "self"), ("flat", "all"), ("ego", "team")]


def alone(observations="raw", observe="self", **options):
    """A hider with nobody to hide from, and everything that games have."""
    return maax.make(
        "hide_and_seek", impl="c", scenario="empty", n_hiders=1, n_seekers=0, n_boxes=1, n_ramps=0, cone=2.0,
        lidar=LidarConfig(n_rays=5), lock=LockConfig(), grab=GrabConfig(), observations=observations, observe=observe,
        **options,
    )  # fmt: skip


@pytest.mark.parametrize(("observations", "observe"), MODES)
def test_spaces_contain_what_one_agent_observes(observations, observe):
    env = alone(observations, observe)
    space = env.observation_space
    arrays = {name: np.zeros(one.shape, one.dtype) for name, one in env.state_shape.obs.items()}
    assert space.contains(arrays)
    for name, array in arrays.items():
        others = [axis for axis in env.observed[name].axes if axis == "other"]
        assert (array.size == 0) == bool(others), name
    if observations == "flat":
        columns = [column.name for column in env.observed["obs"].columns]
        assert len(columns) == space["obs"].shape[1]
        assert not [name for name in columns if name.startswith("agent_qpos_qvel[")], "nobody else is in it"


TRANSFER = (
    "lock_and_return", "sequential_lock", "blueprint", "shelter", "object_counting", "lock_all", "lock_order",
)  # fmt: skip
EVERY_MODE = [("raw", "self"), *product(("split", "flat", "ego"), ("self", "team", "all"))]


@pytest.mark.slow
@pytest.mark.parametrize("game", TRANSFER)
def test_transfer_tasks_are_observed_in_every_mode(game):
    """All ten."""
    for observations, observe in EVERY_MODE:
        env = maax.make(game, impl="c", observations=observations, observe=observe)
        arrays = {name: np.zeros(one.shape, one.dtype) for name, one in env.state_shape.obs.items()}
        assert env.observation_space.contains(arrays), (observations, observe)


def test_a_crowd_of_none_is_padded():
    split = alone("split")
    padded = maax.SpoofEntities(split, 3, ["agent_qpos_qvel", "box_obs"])
    state = jax.jit(padded.reset)(seeds.key(0))
    assert padded.observation_space.contains(jax.device_get(state.obs))
    assert state.obs["agent_qpos_qvel"].shape[1] == 3
    assert not state.obs["agent_qpos_qvel"].any()
    assert not state.obs["agent_mask_spoof"].any()
    np.testing.assert_array_equal(state.obs["box_mask_spoof"], [[True, False, False]])


@pytest.mark.slow
@pytest.mark.parametrize(("observations", "observe"), [("flat", "all"), ("ego", "team")])
def test_games_of_one_keep_the_contract(observations, observe):
    maax.testing.check_env(alone(observations, observe), n_worlds=2, n_steps=2, seed=seeds.seed(0))


@pytest.mark.slow
def test_tag_alone_keeps_the_contract():
    env = maax.make("tag", impl="c", **{"teams.players": 1})
    maax.testing.check_env(env, n_worlds=2, n_steps=2, seed=seeds.seed(0))
