"""Interventions take away what they say, and nothing else."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.training.config import NetConfig
from maax_mjx.training.interventions import INTERVENTIONS, Blinded, WithoutRamps, WithoutTools
from maax_mjx.training.network import Network
from maax_mjx.training.policy import game_of
from maax_mjx.wrappers import find

N = 8
KINDS = {"hiders_without_tools": WithoutTools, "seekers_blind": Blinded, "no_ramps": WithoutRamps}
"""Layers of what is taken away at once: each from another sense, hand or number."""


@pytest.fixture(scope="module")
def policy():
    """An untrained policy of the quadrant, whose episodes are short."""
    env = maax.make("hide_and_seek_quadrant", impl="c", observations="ego", horizon=10)
    network = Network.of(env, NetConfig(core="none", width=8, heads=2, hidden=8))
    return training.Policy(network, jax.device_get(network.draw(jax.random.key(0))), game_of(env))


@pytest.fixture(scope="module")
def played(policy):
    """The game with all of it taken away, its first states, and those of an episode in which all is tried."""

    def without(env):
        return functools.reduce(lambda inner, name: INTERVENTIONS[name][1](inner), KINDS, env)

    env = policy.make_env(tools=True, n_ramps=(0, 2), outside={"TrackTools": without})
    policy.on(env)
    n_steps = env.base.horizon - 1

    def play(key):
        def step(state, i):
            action = env.sample_action(jax.random.fold_in(key, i))
            action |= {tool: jnp.ones_like(action[tool]) for tool in ("grab", "lock")}
            state = env.step(state, action)
            return state, state

        first = env.reset(key)
        return first, jax.lax.scan(step, first, jnp.arange(n_steps))[1]

    return env, *jax.device_get(jax.jit(jax.vmap(play))(jax.random.split(seeds.key(0), N)))


def test_other_games_are_refused():
    with pytest.raises(ValueError, match="name: got 'no_ramps' for a policy of tag; takes a policy of a game with the"):
        training.intervened(training.Policy.load("tag/trained"), "no_ramps")


@pytest.mark.parametrize("name", KINDS)
def test_games_have_what_takes_away(policy, name):
    """In the game that they learnt, around what counts."""
    env = training.intervened(policy, name)
    outer = next(layer for layer in env.layers if isinstance(layer.env, maax.TrackTools))
    assert type(outer) is KINDS[name]
    team = {"hiders_without_tools": "hiders", "seekers_blind": "seekers"}.get(name)
    assert team is None or np.flatnonzero(outer._who).tolist() == list(env.teams[team].slots)


@pytest.mark.slow
def test_hiders_without_tools_hold_and_lock_nothing(played):
    env, _, states = played
    held = states.mechanics["grabs"].held
    hiders = list(env.teams["hiders"].slots)
    assert (held[..., hiders] == -1).all()
    assert not states.mechanics["locks"].locked.any(), "seekers are outside, and boxes in the room"
    # In few steps they may not have come near anything: what they ask for is taken away before.
    ones = {tool: jnp.ones(env.n_agents, jnp.int8) for tool in ("grab", "lock")}
    asked = find(env, WithoutTools).action(None, ones)
    for tool in ones:
        assert not asked[tool][jnp.array(hiders)].any()
        assert asked[tool][jnp.array(env.teams["seekers"].slots)].all()


@pytest.mark.slow
def test_blind_seekers_see_nothing_and_hiders_do(played):
    env, first, states = played
    hiders, seekers = (list(env.teams[name].slots) for name in ("hiders", "seekers"))
    for obs in (first.obs, jax.tree.map(lambda x: x[:, -1], states.obs)):
        lidar = obs["lidar"]
        assert not lidar[:, seekers].any()
        assert lidar[:, hiders].any()
        for name in ("sees_box", "sees_others"):
            assert name not in obs or not np.asarray(obs[name])[:, seekers].any(), name


@pytest.mark.slow
def test_worlds_without_ramps_have_none(played):
    _, first, states = played
    assert not first.world.active["ramp"].any()
    assert first.world.active["box"].all()
    assert not states.metrics["max_ramp_move"].any()


@pytest.mark.slow
def test_ramps_go_back_when_preparation_ends(policy):
    env, end = training.intervened(policy, "ramps_put_back"), 4
    ids = env.base.modules["ramp"].qpos_ids[0, :2]
    reset, step = (jax.jit(jax.vmap(function)) for function in (env.reset, env.step))
    first = state = reset(jax.random.split(seeds.key(0), N))
    start, still = first.data.qpos[:, ids], jax.vmap(env.sample_action)(first.key)
    still = jax.tree.map(jnp.zeros_like, still) | {"move": jnp.full_like(still["move"], 5)}
    for i in range(1, end + 2):
        # Carried off in the second step and in the one after preparation, by a hand that is not the game's.
        if i in (2, end + 1):
            state = state.replace(data=state.data.replace(qpos=state.data.qpos.at[:, ids].add(0.03)))
        state = step(state, still)
        away = np.linalg.norm(state.data.qpos[:, ids] - start, axis=1)
        assert (away > 0.01).mean() > 0.5 if i in (2, 3, end + 1) else (away < 1e-3).all(), i
    assert not state.metrics["physics_fault"].any()
    with pytest.raises(ValueError, match="ramps_put_back: got a game in which ramps can be locked"):
        training.intervened(policy, "ramps_put_back", **{"lock.objects": ("box", "ramp")})


class Mine(maax.Wrapper):
    """A wrapper of one's own."""


def test_a_game_with_wrappers_of_ones_own_is_taken_from_as_well(policy):
    side = training.interventions.INTERVENTIONS["seekers_blind"][0]
    mine = {side: {"Lidar": Mine}}
    env = training.intervened(policy, "seekers_blind", **mine)
    kinds = [type(layer) for layer in env.layers]
    assert KINDS["seekers_blind"] in kinds
    assert Mine in kinds
    with pytest.raises(ValueError, match="tools: got False; takes True, since interventions are beside what tools"):
        training.intervened(policy, "seekers_blind", tools=False)


def test_what_is_not_there_is_not_taken_away(policy):
    with pytest.raises(ValueError, match="name: got 'no_ramps' for a game with n_ramps=0; takes one with ramps"):
        training.intervened(policy, "no_ramps", n_ramps=0)


def test_an_unknown_intervention_is_refused(policy):
    with pytest.raises(ValueError, match=r"name: got 'no_ramp'.*no_ramps"):
        training.intervened(policy, "no_ramp")
