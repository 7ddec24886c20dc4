"""What files have of an environment, and how two of them are told apart."""

import copy
import json
from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.common.recorded import unchanged
from maax_mjx.core.env import Made
from maax_mjx.core.identity import about_environment, about_game, difference
from maax_mjx.core.texts import constructed, whole_text
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
    assert was["layers"] == ["Scaled(by=2, function=sin)"]
    assert not difference(was, about_environment(Scaled(tag(), 2, function=jnp.sin)))
    other = about_environment(Scaled(env, 3, function=jnp.sin))
    assert difference(was, other) == "Scaled(by=2, function=sin), not Scaled(by=3, function=sin)"
    assert not difference(was, other, wrappers=False)
    assert difference(was, about_environment(env)) == "Scaled(by=2, function=sin), not no further layer"


@dataclass(frozen=True)
class Wind:
    """A group of fields."""

    speed: float = 1.0
    gusts: bool = False


@dataclass(frozen=True)
class CalmConfig(maax.GameConfig):
    """A game whose group is None."""

    wind: Wind | None = None
    way: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class WindyConfig(maax.GameConfig):
    """The same game after its default changed."""

    wind: Wind | None = field(default_factory=lambda: Wind(3.0))
    way: np.ndarray = field(default_factory=lambda: np.zeros(3))


def written(config):
    return json.loads(json.dumps(about_game(Made(None, "game", config))))


def test_groups_of_fields_that_are_none_then_or_today():
    """In both directions, with and without a field of the group that was given."""
    calm, windy = written(CalmConfig()), written(WindyConfig())
    assert recorded_fields(WindyConfig(), calm) == {"wind": None}
    assert recorded_fields(CalmConfig(), windy) == {"wind": Wind(3.0)}
    assert recorded_fields(CalmConfig(), written(WindyConfig(wind=Wind(5.0)))) == {"wind": Wind(5.0)}
    assert recorded_fields(WindyConfig(), written(WindyConfig(wind=Wind(5.0)))) == {"wind.speed": 5.0}
    for a, b in ((calm, windy), (windy, calm)):
        assert "env.wind" in difference(a, b)
    # Made again, they are what they were.
    assert not difference(calm, written(WindyConfig(wind=None)))
    assert not difference(windy, written(CalmConfig(wind=Wind(3.0))))


def test_fields_that_are_arrays_are_compared():
    assert not written(CalmConfig(way=np.zeros(3)))["config"]
    assert written(CalmConfig(way=np.ones(3)))["config"] == {"way": [1.0, 1.0, 1.0]}


def test_modules_are_told_apart_to_the_end():
    def game(friction):
        cylinders = maax.Cylinders(2, (0.3, 0.4), (0.3, 0.4), maax.uniform_placement, friction=friction)
        return about_environment(tag(modules=[cylinders]))

    assert not difference(game((0.5, 0.9)), game((0.5, 0.9)))
    assert "friction=(0.1, 0.2)" in difference(game((0.5, 0.9)), game((0.1, 0.2)))


class Thing:
    """Without a text of its own."""


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.zeros(2000), np.concatenate([np.zeros(1000), np.ones(1), np.zeros(999)])),
        (np.array([1.0]), np.array([1.0 + 1e-9])),
        (jnp.zeros(3), jnp.ones(3)),
        (jax.random.key(0), jax.random.key(1)),
        (np.array([{1}, None], object), np.array([{2}, None], object)),
        (partial(jnp.sin, 1), partial(jnp.sin, 2)),
        ({"a": [1, (2, 3)]}, {"a": [1, (2, 4)]}),
        (frozenset("ab"), frozenset("ac")),
        (Wind(1.0), Wind(2.0)),
        (jnp.sin, jnp.cos),
    ],
)
def test_arguments_are_told_apart(a, b):
    assert whole_text(a) != whole_text(b)
    assert whole_text(a) == whole_text(a if isinstance(a, partial) or callable(a) else copy.deepcopy(a))
    assert "0x" not in whole_text(Thing())


def test_the_same_arguments_in_other_words_are_the_same():
    env = tag()
    assert constructed(Scaled(env, 2)) == constructed(Scaled(env, by=2)) == constructed(Scaled(by=2, env=env))
    assert constructed(Scaled(env, np.float64(2.0))) == constructed(Scaled(env, 2.0))
    # Another environment than the one that is wrapped counts.
    assert constructed(Scaled(env, 2, tag(horizon=7))) != constructed(Scaled(env, 2, tag(horizon=8)))
    assert constructed(Scaled(env, None)) == "Scaled(by=None)"


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
