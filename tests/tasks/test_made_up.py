"""What the published transfer tasks make up: constant observations, and policies of hide-and-seek that read them."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers import openai_oracle as oracle
from helpers import seeds

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.training.openai.policy import TASKS

OTHERS = {"lock_and_return": 1, "sequential_lock": 1, "shelter": 2, "blueprint": 2}
HIDER = {"lock_and_return": 1, "sequential_lock": 1, "shelter": 0, "blueprint": 0}
BOXES = {"lock_and_return": 1, "sequential_lock": 4, "shelter": 8, "blueprint": 8}
BEFORE_ONESELF = (*oracle.KINDS, oracle.SITES, oracle.MAIN)
AFTER_ONESELF = (*oracle.KINDS, oracle.MAIN, oracle.SITES)


@functools.cache
def arrays(kinds):
    return oracle.draw(oracle.FULL, seeds.rng(0), kinds=kinds)


@functools.cache
def policy(name, sites=AFTER_ONESELF):
    """Made-up weights of the published names and shapes, in a file of the task's name."""
    with tempfile.TemporaryDirectory() as folder:
        kinds = sites if name == "blueprint" else oracle.KINDS
        return training.Policy.from_openai(oracle.write(Path(folder) / f"{name}.npz", arrays(kinds)))


@functools.cache
def env(name):
    return policy(name).make_env(impl="c", horizon=4)


@pytest.mark.parametrize("name", [*TASKS, "blueprint"])
def test_a_published_policy_reads_what_the_published_task_tells(name):
    """The table of the published code's final observations, from a description of it."""
    game = env(name)
    assert type(game.base.modules["box"]).__name__ == "Boxes"
    state = jax.jit(game.reset)(seeds.key(1))
    read = policy(name).on(game).play.adapter.read(state.obs)
    read = {key: np.asarray(x)[0] for key, x in read.items()}
    n = OTHERS[name]
    ids = game.base.agents.qpos_ids[0]
    pose = np.asarray(state.data.qpos)[ids]
    corner = pose - [0.15, 0.15, 0.15, 0]
    np.testing.assert_allclose(read["observation_self"][:4], corner, atol=1e-6)
    np.testing.assert_array_equal(read["observation_self"][8:], [HIDER[name], 0])
    np.testing.assert_array_equal(read["agent_qpos_qvel"], np.zeros((n, 10)))
    np.testing.assert_array_equal(read["mask_aa_obs"], [1] + [0] * (n - 1))
    assert read["box_obs"].shape == (BOXES[name], 15)
    assert read["lidar"].shape == (30, 1)
    if name == "sequential_lock":
        ramps = np.asarray(state.data.xpos)[game.base.modules["ramp"].body_ids]
        np.testing.assert_allclose(read["ramp_obs"][:, :3], ramps - 0.25, atol=1e-6)
        np.testing.assert_array_equal(read["ramp_obs"][:, 9:], np.zeros((3, 6)))
    else:
        np.testing.assert_array_equal(read["ramp_obs"], np.zeros((1, 15)))
        np.testing.assert_array_equal(read["mask_ar_obs"], [0])


def test_construction_sites_are_read():
    """Middles, then corners at (-,-), (-,+), (+,-) and (+,+) of sites of half a metre; those absent are zeros."""
    game = env("blueprint")
    states = jax.jit(jax.vmap(game.reset))(jax.random.split(seeds.key(2), 8))
    assert len({int(n) for n in np.asarray(states.obs["construction_site_mask"]).sum(axis=(1, 2))}) > 1
    for world in range(8):
        obs = {name: np.asarray(x[world]) for name, x in states.obs.items()}
        read = policy("blueprint").on(game).play.adapter.read(obs)
        there = obs["construction_site_mask"][0]
        wanted = np.zeros((4, 15))
        for i in np.flatnonzero(there):
            middle = obs["construction_site_pos"][0, i]
            corners = [middle + np.array([x, y, 0]) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
            wanted[i] = np.concatenate([middle, *corners])
        np.testing.assert_allclose(read["construction_site_obs"][0], wanted, atol=1e-6)
        np.testing.assert_array_equal(read["mask_acs_obs_spoof"][0], there)


@pytest.mark.parametrize("kinds", [BEFORE_ONESELF, AFTER_ONESELF], ids=["before oneself", "after oneself"])
def test_blueprints_network_attends_to_sites(kinds):
    """Logits and memories are the oracle's, whichever embedding has which number; sites count."""
    game = env("blueprint")
    mine = policy("blueprint", kinds).on(game)
    obs = {name: np.asarray(x) for name, x in jax.jit(game.reset)(seeds.key(3)).obs.items()}
    read = jax.device_get(mine.play.adapter.read(obs))
    network, memory = jax.jit(mine.play.network), mine.memory(1)[0]
    tower, remembered = oracle.Tower(oracle.FULL, arrays(kinds), kinds=kinds), None
    for _ in range(2):
        logits, memory = network(mine.params, read, memory)
        wanted, remembered = tower.logits(read, remembered or tower.memory(1))
        for name, x in wanted.items():
            np.testing.assert_allclose(logits[name], x, rtol=0, atol=1e-5 * np.abs(x).max(), err_msg=name)
        np.testing.assert_allclose(memory, np.concatenate(remembered, axis=-1), atol=1e-5)
    moved = read | {"construction_site_obs": read["construction_site_obs"] + read["mask_acs_obs_spoof"][..., None]}
    other, _ = network(mine.params, moved, memory)
    same, _ = network(mine.params, read, memory)
    assert np.abs(np.asarray(other["action_movement"]) - same["action_movement"]).max() > 1e-3


def test_blueprints_policy_needs_sites():
    with pytest.raises(ValueError, match=r"policy: it reads 'construction_site_pos', and env does not have it; takes"):
        policy("blueprint").on(env("shelter"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lock_and_return", "blueprint"])
def test_it_plays_the_task_of_its_file(name):
    game = env(name)
    worlds = maax.Worlds(game, 2)
    states, kept = worlds.rollout(worlds.reset(seeds.key(0)), policy(name), 3, keep=("action",))
    assert kept["action"]["move"].shape == (3, 2, 1, 3)
    assert set(np.unique(kept["action"]["lock"])) <= {0, 1}
    assert game.observation_space.contains(jax.tree.map(lambda x: np.asarray(x)[0], states.obs))
    with pytest.raises(ValueError, match="a transfer task with made_up=True"):
        policy("lock_and_return").on(maax.make("lock_and_return", impl="c"))


def test_constants_are_the_same_in_all_worlds_and_are_split():
    base = maax.make("standard", impl="c", scenario="empty", n_hiders=2, n_seekers=0, n_boxes=0, n_ramps=0)
    prices = np.array([[1.0, 2.0], [3.0, 4.0]])
    game = maax.AddConstantObservations(
        base,
        {
            "price": (maax.Observed(("good",), (maax.Column("buy"), maax.Column("sell"))), prices),
            "rank": (maax.Observed(("agent",)), np.arange(2)),
        },
    )
    game = maax.SplitObservations(game)
    states = jax.jit(jax.vmap(game.reset))(jax.random.split(seeds.key(0), 3))
    np.testing.assert_array_equal(states.obs["price"], np.broadcast_to(prices, (3, 2, 2, 2)))
    np.testing.assert_array_equal(states.obs["rank"], [[0, 1]] * 3)
    assert game.observed["price"].axes == ("agent", "good")


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        ({"agent_pos": (maax.Observed(()), 1.0)}, "'agent_pos', which is observed already"),
        ({"x": 3.0}, r"for 'x'; takes \(Observed"),
        ({"x": (maax.Observed(()), "red")}, "takes an array of numbers"),
        ({"x": (maax.Observed(("agent",)), np.zeros((2, 2)))}, r"'x' has shape \(2, 2\)"),
        ({"x": (maax.Observed(("agent",)), np.zeros(3))}, "axis 'agent' has length"),
        ({"x": (maax.Observed(()), float("nan"))}, "takes finite numbers of 32 bits"),
        ({"x": (maax.Observed(("good",)), [2**40])}, "takes finite numbers of 32 bits"),
        ({"x": (maax.Observed(("good",)), [[1], [2, 3]])}, "takes an array of numbers"),
        ([("x", 1)], "takes a dict by name"),
        ({"x": (maax.Observed(("agent",), seen="sees_dragon"), np.zeros(2))}, "got the mask 'sees_dragon' for 'x'"),
    ],
)
def test_what_does_not_fit_is_refused(constants, message):
    base = maax.make("standard", impl="c", scenario="empty", n_hiders=2, n_seekers=0, n_boxes=0, n_ramps=0)
    with pytest.raises(ValueError, match=message):
        maax.AddConstantObservations(base, constants)


def test_only_split_observations_have_made_up_ones():
    with pytest.raises(ValueError, match="made_up: got True with observations='ego'"):
        maax.make("shelter", impl="c", made_up=True, observations="ego")
