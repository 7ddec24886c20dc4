"""Scripted players of tag and of capture the flag: where they go, and that they play better than chance."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.tasks import scripted_players
from maax_mjx.training.evaluate import seats

QUICK = {"impl": "c", "n_frames": 10, "horizon": 100}


@pytest.fixture(scope="module")
def tag():
    return maax.make("tag", n_boxes=0, n_ramps=0, **QUICK)


@pytest.fixture(scope="module")
def flags():
    return maax.make("capture_the_flag", n_boxes=0, **QUICK)


def begun(env):
    return jax.jit(env.reset)(seeds.key(0))


def put(env, state, at):
    """Moves agents to places (n_agents, 2)."""
    ids = env.base.agents.qpos_ids[:, :2]
    return state.replace(data=state.data.replace(qpos=state.data.qpos.at[ids].set(jnp.asarray(at, jnp.float32))))


def directions(forces):
    return np.asarray(forces)[:, :2] / np.linalg.norm(np.asarray(forces)[:, :2], axis=1, keepdims=True)


def cosines(forces, to):
    to = np.asarray(to) / np.linalg.norm(to, axis=1, keepdims=True)
    return (directions(forces) * to).sum(axis=1)


@pytest.mark.parametrize(("safe", "safe_for", "chosen"), [(-1, 0, 0), (0, 5, 2), (0, 0, 0)])
def test_who_is_it_chases_the_nearest_whom_it_can_tag(tag, safe, safe_for, chosen):
    at = np.array([[3.0, 2.2], [3.0, 3.0], [4.2, 3.0], [1.5, 3.0]])
    state = put(tag, begun(tag), at)
    now = state.mechanics["tag"].replace(it=jnp.int32(1), safe=jnp.int32(safe), safe_for=jnp.int32(safe_for))
    state = state.replace(mechanics=state.mechanics | {"tag": now})
    forces = scripted_players.tag(state, tag)
    away = at - at[1]
    away[1] = at[chosen] - at[1]
    np.testing.assert_allclose(cosines(forces, away), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(forces, axis=1), 1, atol=1e-5)


def test_who_flees_does_not_stay_at_a_wall(tag):
    """With the wall behind, it goes along it or off, and no further into it."""
    at = np.array([[0.2, 3.0], [1.0, 3.1], [5.8, 0.2], [3.0, 5.8]])
    state = put(tag, begun(tag), at)
    now = state.mechanics["tag"].replace(it=jnp.int32(1))
    forces = directions(scripted_players.tag(state.replace(mechanics=state.mechanics | {"tag": now}), tag))
    assert forces[0, 0] > 0
    assert forces[2, 0] < 0
    assert forces[2, 1] > 0
    assert forces[3, 1] < 0


def test_fetchers_carriers_guards_and_who_is_out(flags):
    env = flags
    state = begun(env)
    base = np.asarray(state.world.sites["flag"])[:, :2]
    game = state.mechanics["capture_the_flag"]

    def goes(at, **changed):
        now = game.replace(**{name: jnp.asarray(x) for name, x in changed.items()})
        moved = put(env, state, at).replace(mechanics=state.mechanics | {"capture_the_flag": now})
        return scripted_players.capture_the_flag(moved, env)

    inwards = np.sign(3.0 - base[:, 0])
    off = np.stack([inwards, [0.0, 0.0]], axis=1)
    nobody, none = np.zeros(4, bool), np.int32([-1, -1])
    # A blue one has passed the guard of the reds' flag, to whom it turns its back; the other guards its own.
    at = np.array([base[1] + 1.6 * off[1], base[0] + 0.5 * off[0], base[1] + 0.5 * off[1], base[1] + off[1]])
    forces = goes(at, out=nobody, carrier=none)
    assert cosines(forces, [base[1] - at[0]] * 4)[0] > 0.99
    assert cosines(forces, [base[0] - at[1]] * 4)[1] > 0.99
    assert cosines(forces, [at[0] - at[3]] * 4)[3] > 0.99

    # Whoever carries the flag or is out leaves for the door; guards do not care for those who are out.
    door = np.asarray(state.world.plan.doors)[0, :2]
    carrying = goes(at, out=nobody, carrier=np.int32([-1, 0]))
    out = goes(at, out=np.array([True, False, False, False]), carrier=none)
    for forces, guard in ((carrying, at[0] - at[3]), (out, base[1] - at[3])):
        assert cosines(forces, [door - [0, np.sign(3.0 - at[0, 1]) * 0.35] - at[0]] * 4)[0] > 0.99
        assert cosines(forces, [guard] * 4)[3] > 0.99


def test_scripts_are_refused_where_they_cannot_play(tag, flags):
    with pytest.raises(ValueError, match="tag: got a game without Tag; takes one with it, such as the game 'tag'"):
        training.SCRIPTED["tag"].on(flags)
    with pytest.raises(KeyError, match=r"got 'chaser' .did you mean 'chase'.*; takes one of"):
        training.SCRIPTED["chaser"]
    with pytest.raises(ValueError, match="capture_the_flag: got a game without CaptureTheFlag"):
        training.SCRIPTED["capture_the_flag"].on(tag)


def test_policies_have_every_second_seat_where_all_play_against_all(tag, flags):
    np.testing.assert_array_equal(seats(tag, "players"), [True, False, True, False])
    two = maax.make("tag", teams={"cats": 1, "mice": 2}, **QUICK)
    np.testing.assert_array_equal(seats(two, "mice"), [False, True, True])
    np.testing.assert_array_equal(seats(flags, "reds"), [False, False, True, True])


@pytest.mark.slow
def test_tag_is_played_better_than_at_random(tag):
    (match,) = training.evaluate("tag", ["random"], 32, tag).matches
    assert match.won.mean - match.won.margin > 0.7
    assert match.metrics["tags"].mean > 0.5


@pytest.mark.slow
def test_flags_are_captured_from_random_players(flags):
    found = training.evaluate("capture_the_flag", ["random"], 24, flags)
    for team in ("blues", "reds"):
        match = found.of(team, "random")
        assert match.won.mean > 0.75
        assert match.metrics[f"score_{team}"].mean > 0.5


class Paid(maax.RewardWrapper):
    """A reward of 2 a step for every seeker who is there, and of 1 for hiders."""

    def reward(self, state):
        return jnp.array([1.0, 2.0]) * state.active


def test_episodes_without_one_of_the_sides_do_not_count():
    """Half of the worlds have no seeker: the mean return of the others is exact, and hiders never win."""
    env = maax.Base(2, impl="c", n_frames=1, horizon=3)
    env.add_module(maax.Agents({"hiders": 1, "seekers": (0, 1)}))
    env = Paid(maax.TeamMembership(env))
    there = jax.vmap(env.reset)(jax.random.split(seeds.key(0), 64)).active[:, 1]
    assert 10 < there.sum() < 54
    found = training.evaluate("random", ["random"], 24, env)
    for team, score, won in (("hiders", 3.0, 0.0), ("seekers", 6.0, 1.0)):
        match = found.of(team, "random")
        assert (match.score.mean, match.score.margin, match.won.mean) == (score, 0.0, won)
        assert 2 < match.episodes < 22
    worlds = maax.Worlds(env, 2)

    def without_seekers(seed):
        return not worlds.reset(jax.random.split(jax.random.key(seed))[0]).active[:, 1].any()

    seed = next(seed for seed in range(40) if without_seekers(seed))
    with pytest.raises(ValueError, match="episodes: got 2, and in none of them, as hiders against random, the physics"):
        training.evaluate("random", ["random"], 2, env, teams=["hiders"], seed=seed)


@pytest.mark.slow
def test_a_team_alone_is_held_against_the_same_worlds_without_it(fast_programs):
    env = maax.make("lock_and_return", impl="c", scenario="empty", horizon=60, n_boxes=1)
    (match,) = training.evaluate("lock_and_return", ["still"], 8, env).matches
    assert match.won.mean > 0.8
    assert match.score.mean > 0
