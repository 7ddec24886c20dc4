"""Visited states as beginnings of episodes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.toys import echo

import maax_mjx as maax
from maax_mjx.core.state import plain
from maax_mjx.parallel.episodes import Visited, without_engine
from maax_mjx.training import PRESETS, NetConfig, PPOConfig, TrainConfig, VisitedConfig, preset
from maax_mjx.training.collect import Remembered, collect
from maax_mjx.training.config import check_divides
from maax_mjx.training.learner import compile_iteration, metrics_of, new_learner
from maax_mjx.training.network import Network
from maax_mjx.training.visited import Archive, looked_at, surprise

N, SIZE, STAY = 32, 16, 4
PPO = PPOConfig(unroll=8, chunk=4, epochs=1, minibatches=2, stop_kl=None)
CONFIG = TrainConfig(
    worlds=N,
    net=NetConfig(encoder="flat", core="none", hidden=16),
    ppo=PPO,
    visited=VisitedConfig(share=0.5, size=SIZE, stay=STAY),
)


@pytest.fixture(scope="module")
def worlds():
    return maax.Worlds(echo(horizon=5), N, donate=False)


@pytest.fixture(scope="module")
def start(worlds):
    return worlds.reset(seeds.key(0), stagger=True)


def numbered(archive, first):
    """Candidates whose step is their number."""
    rows = jax.tree.map(lambda x: jnp.repeat(x[:1], 8, axis=0), archive.state)
    return rows.replace(step=jnp.arange(first, first + 8, dtype=jnp.int32))


def test_an_archive_keeps_the_newest(worlds):
    archive = Archive.empty(worlds.env, SIZE, N)
    even = jnp.ones(8)
    for i in range(5):
        archive = archive.kept(numbered(archive, 8 * i), even, 4, seeds.key(i))
        assert int(archive.there.sum()) == min(4 * (i + 1), SIZE)
        rounds = np.asarray(archive.state.step)[np.asarray(archive.there)] // 8
        np.testing.assert_array_equal(rounds, np.repeat(np.arange(i, max(i - 4, -1), -1), 4))
    assert len(set(np.asarray(archive.state.step).tolist())) == SIZE, "none is kept twice"


def test_states_are_kept_in_proportion_to_their_score(worlds):
    archive = Archive.empty(worlds.env, SIZE, N)
    score = jnp.array([0.0, 1.0, 2.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    rows = numbered(archive, 0)
    draw = jax.jit(jax.vmap(lambda key: archive.kept(rows, score, 1, key).state.step[0]))
    counts = np.bincount(np.asarray(draw(jax.random.split(seeds.key(1), 4000))), minlength=8) / 4000
    np.testing.assert_allclose(counts, np.asarray(score) / 8, atol=0.04)


def test_surprise_is_of_agents_that_count():
    gain = jnp.array([[1.0, -3.0], [1.0, -3.0], [1.0, -3.0]])
    counts = jnp.array([[True, True], [True, False], [False, False]])
    np.testing.assert_array_equal(surprise(gain, counts), [2, 1, 0])


def test_beginnings_are_drawn_from_what_is_there(worlds, start):
    archive = Archive.empty(worlds.env, SIZE, N)
    keys = jax.random.split(seeds.key(2), N)
    assert not archive.beginnings(start, 0.9, keys).taken.any(), "an archive with nothing in it begins nothing"
    archive = archive.replace(there=jnp.arange(SIZE) < 3)
    drawn = jax.jit(jax.vmap(lambda keys: _drawn(archive, start, keys)))
    index, taken = drawn(jax.vmap(lambda key: jax.random.split(key, N))(jax.random.split(seeds.key(3), 100)))
    np.testing.assert_allclose(np.bincount(np.asarray(index).ravel()) / index.size, [1 / 3] * 3, atol=0.05)
    assert abs(float(taken.mean()) - 0.25) < 0.03


def test_an_archive_with_gaps_begins_with_what_is_there(worlds, start):
    """As where those of two devices become one before they are full."""
    there = jnp.arange(SIZE) % 5 == 2
    archive = Archive.empty(worlds.env, SIZE, N).replace(there=there)
    index, _ = _drawn(archive, start, jax.random.split(seeds.key(4), N))
    assert there[index].all()
    assert len(set(np.asarray(index).tolist())) == int(there.sum())


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_preset_takes_a_share(name):
    check_divides(preset(name, {"visited.share": 0.5}), 1)


def _drawn(archive, states, keys):
    visited = archive.beginnings(states, 0.25, keys)
    return visited.index, visited.taken


def test_episodes_begin_in_the_middle_of_others(worlds, start):
    """In a run of the learner: where the running episode began so, and which end counts."""
    network = Network.of(worlds.env, CONFIG.net)
    learner = new_learner(network.draw(seeds.key(0)), CONFIG)
    iterate = compile_iteration(worlds, network, CONFIG)
    states = jax.tree.map(jnp.copy, start)
    memory = Remembered(network.memory(N), (), Archive.empty(worlds.env, SIZE, N))
    for i in range(6):
        learner, states, memory, _ = iterate(learner, None, jax.random.fold_in(seeds.key(1), i), states, memory)
    archive = memory.archive
    assert archive.there.all()
    began = np.asarray(states.step) - np.asarray(states.episode_length)
    running = ~np.asarray(states.done)
    visited = np.asarray(archive.begun)
    assert 0 < visited.sum() < N
    assert (began[running & ~visited] == 0).all()
    assert set(began[running & visited].tolist()) <= set(range(5))
    assert (began[running & visited] > 0).any()
    play = jax.jit(partial(collect, worlds, network, ppo=PPO, share=0.5))
    _, after, batch, _ = play(learner.weights, None, jnp.arange(N), states, memory, seeds.key(5))
    ends, so = np.asarray(batch.last), np.asarray(batch.visited)
    assert (ends & so).any()
    assert (ends & ~so).any()
    np.testing.assert_array_equal(so[0], visited)
    # What a world is told changes where an episode ended, and only there.
    assert not ((so[1:] != so[:-1]) & ~ends[:-1]).any()
    assert after.archive.state is not None


def test_only_whole_episodes_are_measured(worlds, start):
    """Episodes of `Echo` last five steps: the lengths of those that count are whole."""
    network = Network.of(worlds.env, CONFIG.net)
    weights = network.draw(seeds.key(0))
    archive = Archive.empty(worlds.env, SIZE, N)
    later = start.replace(step=jnp.full(N, 3, jnp.int32))
    rows, _ = looked_at(later, SIZE // STAY, seeds.key(4))
    archive = archive.kept(rows, jnp.ones(len(rows.step)), STAY, seeds.key(5))
    play = jax.jit(partial(collect, worlds, network, ppo=replace(PPO, unroll=20), share=0.9))
    memory = Remembered(network.memory(N), (), archive)
    _, _, batch, _ = play(weights, None, jnp.arange(N), start, memory, seeds.key(6))
    ends = np.asarray(batch.last)
    for world in range(N):
        at = np.flatnonzero(ends[:, world])
        lengths = np.diff(at)
        short = np.asarray(batch.visited)[at[1:], world]
        np.testing.assert_array_equal(lengths, np.where(short, 2, 5))
    found = jax.jit(lambda batch: metrics_of(network, batch, batch.value, batch.value, lambda x: x, 1))(batch)
    whole = ends & ~np.asarray(batch.visited)
    assert 0 < whole.sum() < ends.sum() == found["episodes"]
    for team, slots in network.teams:
        counts = whole[..., None] & np.asarray(batch.counts)[..., list(slots)]
        total = np.asarray(batch.total)[..., list(slots)][counts].mean()
        np.testing.assert_allclose(found[f"return_{team}"], total, rtol=1e-5)
        assert found[f"ended_{team}"] == counts.sum()
    assert found["whole_episodes"] == whole.sum()


def test_an_archive_that_does_not_divide_is_refused():
    with pytest.raises(ValueError, match=r"visited.size: got 10 with visited.stay 4"):
        check_divides(replace(CONFIG, visited=VisitedConfig(share=0.5, size=10, stay=4)), 1)
    with pytest.raises(ValueError, match=r"visited.size: got 16 with visited.stay 4 .* on 8 devices"):
        check_divides(replace(CONFIG, visited=VisitedConfig(share=0.5, size=16, stay=4)), 8)
    with pytest.raises(ValueError, match=r"share: got 1\.0"):
        VisitedConfig(share=1.0)
    check_divides(replace(CONFIG, visited=VisitedConfig(share=0.0, size=10, stay=4)), 1)


@pytest.mark.slow
def test_an_episode_goes_on_from_a_visited_state_as_it_went_on():
    """With preparation, locks and grabs, on `c`: same actions, same states; what was drawn begins the next episode."""
    worlds = maax.Worlds(maax.make("hide_and_seek_quadrant", impl="c", horizon=8), 4, donate=False)
    step = jax.jit(worlds.step_fn)
    begun = states = worlds.reset(seeds.key(0))
    act = jax.vmap(worlds.env.sample_action)
    actions = [act(jax.random.split(seeds.key(i), 4)) for i in range(8)]
    original, stored = [], None
    for i in range(7):
        if i == 3:
            stored = without_engine(plain(states))
        states = step(states, actions[i])
        original.append(states)
    index, taken = jnp.array([1, 0, 3, 2]), jnp.array([True, True, True, False])
    states = step(states, actions[7], Visited(stored, index, taken))
    assert states.done.all()
    np.testing.assert_array_equal(states.step, [3, 3, 3, 0])
    np.testing.assert_array_equal(states.upcoming.stale, ~taken)
    for name in stored.obs:
        np.testing.assert_array_equal(states.obs[name][:3], stored.obs[name][index][:3])
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[:3], b[index][:3]), states.mechanics, stored.mechanics)
    np.testing.assert_array_equal(states.data.eq_active[:3], stored.data.eq_active[index][:3])
    for i in range(3, 7):
        states = step(states, jax.tree.map(lambda x: x[index], actions[i]))
        np.testing.assert_allclose(states.data.qpos[:3], original[i].data.qpos[index][:3], atol=1e-3)
        np.testing.assert_array_equal(states.can_act[:3], original[i].can_act[index][:3])
    states = step(states, actions[7])
    np.testing.assert_array_equal(states.done, [True, True, True, False])
    np.testing.assert_array_equal(states.data.qpos[:3], begun.upcoming.state.data.qpos[:3])
