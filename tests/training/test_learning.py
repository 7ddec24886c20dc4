"""Iterations of training on tiny games: what was played is what is learnt from, and it is learnt."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.toys import echo, unpaid

import maax_mjx as maax
from maax_mjx.training import NetConfig, PPOConfig, TrainConfig
from maax_mjx.training.actions import log_prob
from maax_mjx.training.collect import Remembered, collect
from maax_mjx.training.config import LeagueConfig
from maax_mjx.training.league import League, worlds_of_each
from maax_mjx.training.learner import compile_iteration, new_learner
from maax_mjx.training.network import Network
from maax_mjx.training.ppo import Updates, joined, optimiser, rows_of, update

N = 64
SMALL = {"encoder": "flat", "hidden": 16}
PPO = PPOConfig(unroll=8, chunk=4, epochs=2, minibatches=2, lr=3e-3, gamma=0.9, stop_kl=None)


@pytest.fixture(scope="module")
def worlds():
    return maax.Worlds(echo(), N, donate=False)


@pytest.fixture(scope="module")
def start(worlds):
    return worlds.reset(seeds.key(0), stagger=True)


def settings(core="lstm", **ppo):
    return TrainConfig(worlds=N, net=NetConfig(core=core, **SMALL), ppo=replace(PPO, **ppo))


def learn(worlds, start, config, iterations, opponents=None, seed=0):
    """The metrics of every iteration, and the learner after the last."""
    network = Network.of(worlds.env, config.net)
    learner = new_learner(network.draw(seeds.key(seed)), config)
    iterate = compile_iteration(worlds, network, config)
    states = jax.tree.map(jnp.copy, start)
    memory = Remembered(network.memory(N), () if opponents is None else opponents.memory(network, N))
    rows = []
    for i in range(iterations):
        key = jax.random.fold_in(seeds.key(seed + 1), i)
        learner, states, memory, metrics = iterate(learner, opponents, key, states, memory)
        rows.append({name: float(x) for name, x in metrics.items()})
    return rows, learner


@pytest.fixture(scope="module")
def played(worlds, start):
    """A network, its weights, what it played, and the memories before every chunk."""
    network = Network.of(worlds.env, NetConfig(core="lstm", **SMALL))
    weights = network.draw(seeds.key(3))
    # Last layers begin near zero, where every action is as likely as another.
    rng = seeds.rng(4)
    weights = jax.tree.map(lambda x: np.asarray(x) + (0.3 * rng.normal(size=x.shape)).astype(x.dtype), weights)
    play = jax.jit(partial(collect, worlds, network, ppo=PPO))
    memory = Remembered(network.memory(N), ())
    _, _, batch, before = play(weights, None, jnp.arange(N), start, memory, seeds.key(5))
    return network, weights, batch, before


@pytest.fixture(scope="module")
def updated(played):
    """An update of what was played, as a function of its state and of rows with an axis of microbatches."""
    network = played[0]
    return jax.jit(lambda now, rows: update(now, network, PPO, rows, lambda x: x))


def fresh(weights):
    """The state before the first update."""
    moments = optimiser(PPO).init(joined(weights)[0])
    return Updates(weights, moments, jnp.zeros((), bool), jnp.zeros((), jnp.int32))


@pytest.mark.slow
def test_before_the_first_update_the_ratio_is_one(played):
    """What the update computes from chunks are the numbers with which the actions were drawn."""
    network, weights, batch, before = played
    rows = rows_of(batch, before, batch.reward, batch.value, PPO.chunk)
    out, _ = jax.jit(network.actor)(weights, rows.features, rows.memory.actor, rows.begins)
    value, _ = jax.jit(network.critic)(weights, rows.features, rows.memory.critic, rows.begins)
    now = jax.jit(partial(log_prob, network.heads))(out, rows.action)
    np.testing.assert_allclose(jnp.exp(now - rows.log_prob), 1.0, atol=1e-5)
    np.testing.assert_allclose(value, rows.target, atol=1e-5)
    assert float(jnp.std(rows.log_prob)) > 0.1, "actions differ in how likely they are"


def test_rows_are_of_one_world_in_a_row(played):
    _, _, batch, before = played
    world = jnp.broadcast_to(jnp.arange(N, dtype=jnp.float32)[:, None], batch.reward.shape)
    step = jnp.broadcast_to(jnp.arange(8.0)[:, None, None], batch.reward.shape)
    rows = rows_of(batch, before, world, step, PPO.chunk)
    assert (rows.advantage == rows.advantage[:1]).all()
    np.testing.assert_array_equal(rows.advantage[0, :, 0], np.repeat(np.arange(N), 2))
    np.testing.assert_array_equal(rows.target[:, :, 0].T, np.tile(np.arange(8.0).reshape(2, 4), (N, 1)))
    some = rows.picked(jnp.array([[3, 0], [5, 4]]))
    assert some.target.shape == (2, 4, 2, rows.target.shape[2])
    np.testing.assert_array_equal(some.advantage[:, 0, :, 0], [[1, 0], [2, 2]])
    np.testing.assert_array_equal(some.memory.actor[0, 1], rows.memory.actor[0])


@pytest.mark.parametrize("waiting", [False, True])
def test_a_policy_learns_from_steps_without_effect_only_if_they_count(worlds, start, waiting):
    """Seekers cannot act in the first step; the critic learns from it in either case."""
    network = Network.of(worlds.env, settings().net)
    states = jax.tree_util.tree_map_with_path(
        lambda path, x: x.at[:, 1].set(False) if getattr(path[-1], "name", "") == "can_act" else x, start
    )
    memory = Remembered(network.memory(N), ())
    play = jax.jit(partial(collect, worlds, network, ppo=replace(PPO, waiting=waiting)))
    _, _, batch, _ = play(network.draw(seeds.key(0)), None, jnp.arange(N), states, memory, seeds.key(5))
    assert batch.counts.all()
    assert batch.acts[0, :, 0].all()
    assert (batch.acts[0, :, 1] == waiting).all()


@pytest.mark.slow
def test_only_who_remembers_learns_to_echo(worlds, start):
    with_memory, _ = learn(worlds, start, settings("lstm"), 60)
    without, _ = learn(worlds, start, settings("none"), 30)
    # A policy that has learnt it may lose it for some iterations, on some processors with some seeds.
    last = [np.median([row["return_hiders"] + row["return_seekers"] for row in rows[-25:]]) / 2 for rows in
            (with_memory, without)]  # fmt: skip
    assert last[0] > 0.9, "the sign was remembered"
    assert abs(last[1]) < 0.3, "by chance"


@pytest.mark.slow
def test_opponents_get_no_gradient_and_play_their_own_policy(worlds, start):
    """With every world against past opponents, a team's parameters learn from its own steps alone."""
    config = TrainConfig(worlds=N, net=NetConfig(core="none", share="team", **SMALL), ppo=PPO)
    network = Network.of(worlds.env, config.net)
    league = League(keep=2)
    league.add(network.draw(seeds.key(9)))
    # In block 0 the opponent plays the first team, in block 1 the second; with one block, the first alone.
    opponents = league.draw(0, groups=1, share=1.0)
    first = jax.device_get(network.draw(seeds.key(0)))
    rows, learner = learn(worlds, start, config, 2, opponents)
    learner = jax.device_get(learner)
    frozen, learnt = network.teams[0][0], network.teams[1][0]
    for before, after in ((first.actor, learner.weights.actor), (first.critic, learner.weights.critic)):
        kept = jax.tree.map(lambda a, b: np.array_equal(a, b), before[frozen], after[frozen])
        value = kept.pop("value", True)
        assert all(jax.tree.leaves(kept)), "but for the rescaled last layer of the critic"
        assert value is True or not all(jax.tree.leaves(value))
        changed = jax.tree.map(lambda a, b: not np.array_equal(a, b), before[learnt], after[learnt])
        assert any(jax.tree.leaves(changed))
    assert rows[0]["episodes"] > 0


def test_an_update_that_is_not_finite_is_skipped_and_counted(played, updated):
    _, weights, batch, before = played
    rows = rows_of(batch, before, batch.reward, batch.value, PPO.chunk)
    bad = rows.replace(advantage=rows.advantage.at[0, 0, 0].set(jnp.nan))
    now = fresh(weights)
    after, info = updated(now, jax.tree.map(lambda x: x[None], bad))
    assert float(info["broken"]) == 1
    assert int(after.broken) == 1
    same = jax.tree.map(np.array_equal, (now.weights, now.moments), (after.weights, after.moments))
    assert jax.tree.all(same)
    again, info = updated(after, jax.tree.map(lambda x: x[None], rows))
    assert float(info["broken"]) == 0
    assert int(again.broken) == 0
    assert not jax.tree.all(jax.tree.map(np.array_equal, weights, again.weights))


@pytest.mark.slow
def test_rewards_and_observations_that_are_not_numbers_cost_the_updates_of_their_iteration_alone(worlds, start):
    """They must not get into the scales of critics and observations or into last layers, which no update mends."""
    config = settings("none")
    config = replace(config, net=replace(config.net, norm="running"))
    network = Network.of(worlds.env, config.net)
    bad = maax.Worlds(unpaid(), N, donate=False)
    before = new_learner(network.draw(seeds.key(0)), config)
    states = bad.reset(seeds.key(0))
    obs = {name: x.at[3].set(jnp.nan) if x.dtype == jnp.float32 else x for name, x in states.obs.items()}
    args = None, seeds.key(1), states.replace(obs=obs), Remembered(network.memory(N), ())
    after, _, _, metrics = compile_iteration(bad, network, config)(jax.tree.map(jnp.copy, before), *args)
    assert (float(metrics["broken"]), int(after.broken)) == (1.0, 1)
    kept = jax.tree.map(np.array_equal, (before.scale, before.weights.norm), (after.scale, after.weights.norm))
    assert jax.tree.all(kept)
    assert jax.tree.all(jax.tree.map(np.allclose, before.weights.critic, after.weights.critic))
    assert jax.tree.all(jax.tree.map(np.array_equal, before.weights.actor, after.weights.actor))
    iterate = compile_iteration(worlds, network, config)
    again, _, _, metrics = iterate(
        after, None, seeds.key(2), jax.tree.map(jnp.copy, start), Remembered(network.memory(N), ())
    )
    assert (float(metrics["broken"]), int(again.broken)) == (0.0, 0)
    assert jax.tree.all(jax.tree.map(lambda x: bool(jnp.isfinite(x).all()), again))


def test_microbatches_change_nothing(played, updated):
    _, weights, batch, before = played
    rows = rows_of(batch, before, batch.reward, batch.value, PPO.chunk)
    parts = [updated(fresh(weights), rows.picked(jnp.arange(rows.begins.shape[1]).reshape(n, -1)))[1] for n in (1, 4)]
    for name in parts[0]:
        np.testing.assert_allclose(parts[0][name], parts[1][name], rtol=1e-4, atol=1e-5, err_msg=name)


@pytest.mark.parametrize(("keep", "kept"), [(1, [5]), (2, [0, 5]), (4, [0, 3, 4, 5])])
def test_the_first_and_the_newest_policies_are_kept(keep, kept, played):
    league = League(keep)
    for i in range(6):
        league.add(jax.tree.map(lambda x, i=i: jnp.full_like(x, i), played[1]))
    assert [int(jax.tree.leaves(weights)[0].ravel()[0]) for weights in league.past] == kept


@pytest.mark.parametrize("groups", [1, 3, 4, 16])
@pytest.mark.parametrize("n_worlds", [1, 2, 7, 8, 100, 4096])
def test_past_opponents_play_in_their_share_of_the_worlds(groups, n_worlds):
    """Each in as many; in no more than there are, and where the share is a world, in one at least."""
    for share in np.linspace(0, 1, 21):
        policies = LeagueConfig(share=share, groups=groups).at_once(n_worlds)
        assert policies <= groups
        if share * n_worlds > 0.5:
            each = worlds_of_each(share, policies, n_worlds)
            assert each >= 1
            assert policies * each <= n_worlds
            assert abs(policies * each - share * n_worlds) <= max(policies - 0.5, 0.5)
        else:
            assert policies == 0
