"""A team as one agent of Brax and of MuJoCo Playground."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from helpers import seeds

import maax_mjx as maax
from maax_mjx import adapters
from maax_mjx.adapters.team import OneTeam

HORIZON = 6
REST = 5
"""The bin without force, of eleven."""


@pytest.fixture(scope="module")
def env():
    """Bins, locks and grabs; the second seeker is in play in half of the episodes."""
    return maax.make(
        "hide_and_seek_quadrant", observations="ego", impl="c", scenario="empty", p_door_dropout=0.0,
        box_placement="uniform", n_boxes=1,
        n_ramps=0, lidar=None, rect=None, n_seekers=(1, 2), horizon=HORIZON, prep_fraction=0.0, n_frames=2,
    )  # fmt: skip


@pytest.fixture(scope="module")
def of(env):
    return OneTeam(env, "seekers", "still")


def test_numbers_are_actions_of_all_parts(env, of):
    """In the order of their names, agent after agent: grab, lock, and three forces."""
    vector = seeds.rng(0).uniform(-1.5, 1.5, 10).astype(np.float32)
    assert (of.action_size, len(of.env.teams["seekers"].slots)) == (10, 2)
    action = of.action(jnp.asarray(vector))
    rows = vector.reshape(2, 5)
    np.testing.assert_array_equal(action["grab"], rows[:, 0] > 0)
    np.testing.assert_array_equal(action["lock"], rows[:, 1] > 0)
    np.testing.assert_array_equal(action["move"], np.round((np.clip(rows[:, 2:], -1, 1) + 1) / 2 * 10))
    forces = OneTeam(maax.make("tag", impl="c"))
    assert forces.action_size == 12
    np.testing.assert_allclose(forces.action(jnp.full(12, 2.0))["move"], np.ones((4, 3)))


class Gear(maax.ActionWrapper):
    """Has forces in [-2, 5] and [0, 1], which nothing reads."""

    @property
    def action_space(self):
        low, high = np.tile(np.float32([-2, 0]), (4, 1)), np.tile(np.float32([5, 1]), (4, 1))
        return spaces.Dict({"gear": spaces.Box(low, high)})

    def action(self, state, action):
        return {"move": jnp.zeros((4, 3))}


def test_numbers_span_the_bounds_of_ones_own_parts():
    gears = OneTeam(Gear(maax.make("tag", impl="c")))
    for number, want in ((-1.0, [-2, 0]), (0.0, [1.5, 0.5]), (1.0, [5, 1])):
        np.testing.assert_allclose(gears.action(jnp.full(8, number))["gear"], np.tile(want, (4, 1)))


def test_steps_are_the_environments_with_the_others_played(env, of):
    inside = jax.jit(of.begin)(seeds.key(1))
    vector = seeds.rng(1).uniform(-1, 1, 10).astype(np.float32)
    mine = of.action(jnp.asarray(vector))
    slots = list(env.teams["seekers"].slots)
    joined = {"grab": np.zeros(4, np.int8), "lock": np.zeros(4, np.int8), "move": np.full((4, 3), REST)}
    for name, x in joined.items():
        x[slots] = mine[name]
    wanted = of.env.step(inside.state, joined)
    after = jax.jit(of.step)(inside, vector)
    np.testing.assert_array_equal(after.state.data.qpos, wanted.data.qpos)
    assert not jnp.array_equal(jax.random.key_data(after.key), jax.random.key_data(inside.key))
    obs = of.observation(after)
    assert obs.shape == (of.observation_size,)
    np.testing.assert_array_equal(obs, np.asarray(wanted.obs["obs"])[slots].ravel())
    active = np.asarray(wanted.world.active["agent"])[slots]
    np.testing.assert_allclose(of.reward(after), np.asarray(wanted.reward)[slots][active].mean(), rtol=1e-6)
    assert of.metrics(after).keys() == wanted.metrics.keys()


def test_only_the_horizon_is_left_to_the_library(of):
    inside = of.begin(jax.random.PRNGKey(0))

    def done(step, **fields):
        return float(of.done(inside._replace(state=inside.state.replace(step=jnp.asarray(step), **fields))))

    yes = jnp.asarray(True)
    assert [done(HORIZON - 1), done(HORIZON, truncated=yes)] == [0.0, 0.0]
    assert [done(HORIZON - 1, truncated=yes), done(HORIZON, terminated=yes)] == [1.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "library"), [("brax", "brax"), ("playground", "mujoco_playground")])
def test_their_wrappers_roll_it_out(env, name, library):
    pytest.importorskip(library)
    game = getattr(adapters, name)(env, "seekers", policy="random")
    if name == "brax":
        from brax.envs.wrappers.training import wrap
    else:
        from mujoco_playground import wrapper

        wrap = wrapper.wrap_for_brax_training
    batch = wrap(game, episode_length=HORIZON)
    state = jax.jit(batch.reset)(jax.random.split(jax.random.PRNGKey(0), 3))
    step = jax.jit(batch.step)
    ended = []
    for i in range(2 * HORIZON):
        state = step(state, jax.random.uniform(jax.random.PRNGKey(i), (3, batch.action_size), minval=-1.0))
        ended.append([bool(x) for x in (state.done.all(), state.info["truncation"].all())])
        assert np.isfinite(state.obs).all()
    assert state.obs.shape == (3, batch.observation_size)
    assert ended == [[i % HORIZON == HORIZON - 1] * 2 for i in range(2 * HORIZON)]
    inside = state.pipeline_state if name == "brax" else state.data
    assert not inside.state.step.any(), "a new episode has begun"
    if name == "playground":
        assert (game.dt, game.n_substeps) == (env.base.dt, 2)
        assert game.mj_model is env.base.model
        image = game.render([jax.tree.map(lambda x: x[0], state)], height=48, width=64)[0]
        assert image.shape == (48, 64, 3)


def test_what_is_refused(env):
    with pytest.raises(ValueError, match="policy: got None with the team 'seekers'"):
        OneTeam(env, "seekers")
    with pytest.raises(ValueError, match="team: got 'seeker'; did you mean 'seekers'"):
        OneTeam(env, "seeker", "random")
    whole = OneTeam(env)
    for size in (1, 2 * whole.action_size):
        with pytest.raises(ValueError, match=rf"action: got shape \({size},\); takes \({whole.action_size},\)"):
            whole.action(np.zeros(size))
    with pytest.raises(ValueError, match="action: got NaN; takes numbers"):
        whole.action(np.full(whole.action_size, np.nan))
    with pytest.raises(ValueError, match=r"action: got dict; takes an array"):
        whole.action({})
    assert whole.action([0.0] * whole.action_size)["move"].shape == (4, 3)


def test_nan_is_no_force_where_it_cannot_be_refused(of):
    """Compiled, where it would be the first bin: full force backwards."""
    action = jax.jit(of.action)(jnp.full(of.action_size, jnp.nan))
    assert (action["move"] == REST).all()
    assert not action["lock"].any()
    assert not action["grab"].any()
    forces = jax.jit(OneTeam(maax.make("tag", impl="c")).action)(jnp.full(12, jnp.nan))
    assert jnp.isnan(forces["move"]).all()
