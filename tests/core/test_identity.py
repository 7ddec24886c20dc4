"""What files have of an environment, and how two of them are told apart."""

import json

import jax
import jax.numpy as jnp
import pytest

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.common.recorded import unchanged
from maax_mjx.core.identity import about_environment, about_game, difference
from maax_mjx.tasks.config import recorded_fields


class Scaled(maax.RewardWrapper):
    """Pays a multiple."""

    def __init__(self, env, by, function=None):
        super().__init__(env)
        self.by = by

    def reward(self, state):
        return self.by * state.reward


def tag(**fields):
    return maax.make("tag", impl="c", n_boxes=0, n_ramps=0, **fields)


def test_a_game_has_what_was_changed_and_what_was_not():
    env = tag(horizon=50)
    about = about_game(env.made)
    assert about == json.loads(json.dumps(about))
    assert about["config"] == {"impl": "c", "n_boxes": 0, "n_ramps": 0, "horizon": 50}
    assert about["defaults"]["floor_size"] == maax.config_of("tag").floor_size
    assert not about["config"].keys() & about["defaults"].keys()
    assert "impl" not in about["defaults"]
    assert unchanged(maax.config_of("tag")).keys() >= about["defaults"].keys() | about["config"].keys()


def test_a_default_that_is_another_one_today_does_not_change_a_game():
    about = about_game(tag().made)
    assert recorded_fields(maax.config_of("tag"), about) == {"impl": "c", "n_boxes": 0, "n_ramps": 0}
    then = about["defaults"] | {"horizon": 33, "world_params.gravity": -9.0, "gone_since": 1}
    fields = recorded_fields(maax.config_of("tag"), about | {"defaults": then})
    assert fields == about["config"] | {"horizon": 33, "world_params.gravity": -9.0}
    config = maax.config_of(maax.make("tag", **fields))
    assert (config.horizon, config.world_params.gravity) == (33, -9.0)


def test_a_policy_plays_the_game_that_it_learnt_after_a_default_changed():
    shipped = training.Policy.load("quadrant/chase")
    game = shipped.game | {"defaults": {"horizon": 33}}
    policy = training.Policy(shipped.network, shipped.params, game, shipped.steps)
    assert policy.make_env(impl="c").base.horizon == 33
    assert policy.make_env(impl="c", horizon=7).base.horizon == 7


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ({"horizon": 60}, {"horizon": 60}, ""),
        ({"horizon": 60}, {"horizon": 20}, "env.horizon=60, not 20"),
        ({}, {"horizon": 20}, "env.horizon={default}, not 20"),
        ({"horizon": 20}, {}, "env.horizon=20, not {default}"),
    ],
)
def test_games_differ_by_their_fields(was, now, said):
    a, b = (about_environment(tag(**fields)) for fields in (was, now))
    assert difference(a, b) == said.format(default=maax.config_of("tag").horizon)
    # A file of before there were defaults.
    old = {name: value for name, value in a.items() if name not in ("defaults", "layers")}
    assert bool(difference(old, b)) == bool(said)


def test_games_differ_by_their_defaults_and_not_by_their_engines():
    now = about_environment(tag())
    was = now | {"defaults": now["defaults"] | {"horizon": 33}}
    assert difference(was, now).startswith("env.horizon=33, not ")
    # The field is given now, with the value of then.
    assert not difference(was, about_environment(tag(horizon=33)))
    assert not difference(now, about_environment(maax.make("tag", n_boxes=0, n_ramps=0, impl="jax")))
    assert difference(now, about_environment(maax.make("standard", impl="c"))) == "game=tag, not standard"


def test_wrappers_of_ones_own_are_told_apart():
    env = tag()
    was = about_environment(Scaled(env, 2, function=jnp.sin))
    assert was["layers"] == ["Scaled(2, function=sin)"]
    assert not difference(was, about_environment(Scaled(tag(), 2, function=jnp.sin)))
    other = about_environment(Scaled(env, 3, function=jnp.sin))
    assert difference(was, other) == "Scaled(2, function=sin), not Scaled(3, function=sin)"
    assert not difference(was, other, wrappers=False)
    assert difference(was, about_environment(env)) == "Scaled(2, function=sin), not no further layer"


def test_bases_of_ones_own_are_told_apart():
    def base(boxes, impl="c"):
        env = maax.Base(1, impl=impl)
        env.add_module(maax.Boxes(boxes))
        return about_environment(env)

    assert not difference(base((1, 3)), base((1, 3), impl="jax"), wrappers=False)
    assert "(2, 3)" in difference(base((1, 3)), base((2, 3)), wrappers=False)


def test_rewards_keep_their_type():
    """A step's in float64 as well, or no loop of a user's own would carry it."""
    with jax.enable_x64(True):
        env = Scaled(tag(), 2)
        state = jax.eval_shape(env.reset, jax.random.key(0))
        after = jax.eval_shape(env.step, state, jax.eval_shape(env.sample_action, jax.random.key(0)))
    assert state.reward.dtype == after.reward.dtype == jnp.float64
