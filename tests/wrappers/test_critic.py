"""Critics: the policies' arrays under other masks, and what is for critics alone."""

import functools

import jax
import numpy as np
import pytest
from helpers.layers import observing
from helpers.seeds import key

import maax_mjx as maax
from maax_mjx.tasks import observed_by_agents

equal = np.testing.assert_array_equal
N = 32


@functools.cache
def drawn():
    """The game as it is, and first states of it, which are drawn once."""
    counts = {"n_boxes": (3, 5), "n_elongated_boxes": (1, 3), "lidar": None}
    env = maax.make("hide_and_seek_full", impl="c", observations="raw", **counts)
    return env, jax.jit(jax.vmap(env.reset))(jax.random.split(key(0), N))


def observed(observations, observe):
    """The game under what `make` puts around it, and what that makes of the states."""
    raw, states = drawn()
    env = observed_by_agents(raw, observations, observe)
    return env, jax.device_get(jax.jit(jax.vmap(observing(env, raw)))(states))


@pytest.fixture(scope="module")
def split():
    return observed("split", "all")


@pytest.fixture(scope="module")
def team():
    return observed("split", "team")


@pytest.mark.slow
def test_who_sees_whom_is_everybodys_matrix_in_each_ones_order(split):
    _, state = split
    sees = state.mechanics["line_of_sight"]["sees_agent"]
    for i in range(4):
        order = [(i - k) % 4 for k in range(4)]
        equal(state.obs["who_sees_whom"][:, i], sees[:, order][:, :, order])


def test_a_teams_critic_knows_what_any_of_the_team_sees(team):
    _, state = team
    masks = state.mechanics["line_of_sight"]
    for mine, mates in ((0, [0, 1]), (1, [0, 1]), (2, [2, 3]), (3, [2, 3])):
        order = [(mine - k) % 4 for k in range(4)]
        equal(state.obs["team_sees_box"][:, mine], masks["sees_box"][:, mates].any(axis=1))
        ours = masks["sees_agent"][:, mates].any(axis=1)
        equal(state.obs["team_sees_agent"][:, mine], ours[:, order[1:]])
        known = masks["sees_agent"].copy()
        known[:, [i for i in range(4) if i not in mates]] = False
        equal(state.obs["who_sees_whom"][:, mine], known[:, order][:, :, order])


@pytest.mark.parametrize("observe", ["all", "team"])
def test_flat_views_are_two_maskings_of_the_same_numbers(observe, request):
    _, arrays = request.getfixturevalue("split" if observe == "all" else "team")
    flat, state = observed("flat", observe)
    policy, critic = state.obs["obs"], state.obs["critic"]
    d = policy.shape[-1]
    assert critic.shape[-1] == len(flat.observed["critic"].columns) > d
    assert flat.observed["critic"].names()[:d] == flat.observed["obs"].names()
    hidden = (policy == 0) & (critic[..., :d] != 0)
    equal(policy[~hidden], critic[..., :d][~hidden])
    assert hidden.any()
    names = flat.observed["critic"].names()
    for i in range(5):
        shown = arrays.obs["team_sees_box"][:, :, i] if observe == "team" else arrays.obs["box_mask"][:, :, i]
        x = names.index(f"box_obs[{i}] x")
        equal(critic[..., x], np.where(shown, arrays.obs["box_obs"][:, :, i, 0], 0.0))
    left = names.index("time_left time left")
    assert left >= d
    equal(critic[..., left], 1.0)


def test_policies_do_not_get_what_is_for_critics(split):
    env, _ = split
    alone = {name for name, one in env.observed.items() if one.critic}
    assert alone == {"time_left", "who_sees_whom"}
    names = " ".join(maax.FlattenObservations(env).observed["obs"].names())
    assert not any(name in names for name in alone)


def test_time_runs_down():
    env = maax.make("tag", impl="c", observations="split", observe="all", horizon=4)
    state = env.reset(key(0))
    step = jax.jit(env.step)
    for left in (1.0, 0.75, 0.5, 0.25, 0.0):
        equal(state.obs["time_left"], left)
        state = step(state, {"move": np.zeros((4, 3), np.float32)})


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"observe": "team"}, "observe: got 'team' without LineOfSight"),
        ({"observe": "all", "observations": "raw"}, "observe: got 'all' with observations='raw'"),
        ({"observe": "everything"}, "observe: got 'everything'"),
        ({"observations": "egocentric"}, "observations: got 'egocentric'"),
    ],
)
def test_bad_input(fields, says):
    with pytest.raises(ValueError, match=says):
        maax.make("hide_and_seek", impl="c", **fields)


def small(**fields):
    return maax.make(
        "hide_and_seek_quadrant", impl="c", observations="split", n_boxes=2, n_ramps=0, lidar=None, horizon=20, **fields
    )


def test_a_policys_time_left_stays_the_policys():
    """In both orders; and what somebody else observes under this name is not overwritten."""
    for env in (
        maax.CriticObservations(maax.EgocentricObservations(small())),
        maax.EgocentricObservations(maax.CriticObservations(small())),
    ):
        assert not env.observed["time_left"].critic
    assert maax.CriticObservations(small()).observed["time_left"].critic
    flat = maax.FlattenObservations(maax.CriticObservations(maax.EgocentricObservations(small())))
    assert any("time left" in name for name in flat.observed["obs"].names())


def test_a_teams_critic_of_padded_entities():
    """Its masks are padded likewise, whichever wrapper is outside."""
    env = small()
    inner = maax.CriticObservations(maax.SpoofEntities(env, 5, ["box_obs", "agent_qpos_qvel"]), "team")
    outer = maax.SpoofEntities(maax.CriticObservations(env, "team"), 5, ["box_obs", "agent_qpos_qvel"])
    start = jax.jit(env.reset)(key(1))
    for padded in (inner, outer):
        flat = maax.FlattenObservations(
            maax.SelectObservations(padded, [n for n in padded.observed if "agent_" not in n])
        )
        obs = jax.device_get(jax.jit(observing(padded, env))(start)).obs
        assert obs["team_sees_box"].shape == (4, 5)
        assert obs["team_sees_agent"].shape == (4, 5)
        equal(obs["team_sees_box"][:, :2], obs["sees_box"][[[0, 1], [0, 1], [2, 3], [2, 3]], :2].any(axis=1))
        assert not obs["team_sees_box"][:, 2:].any()
        assert flat.observation_space["critic"].shape[0] == 4


def test_masks_that_a_teams_critic_lacks_are_named():
    some = ["box_obs", "box_mask", "sees_box", "agent_qpos_qvel_self"]
    with pytest.raises(ValueError, match=r"observe: got 'team' where 'sees_box' is not observed; takes that mask, or"):
        maax.CriticObservations(maax.SelectObservations(small(), ["box_obs", "box_mask"]), "team")
    critics = maax.SelectObservations(maax.CriticObservations(small(), "team"), some)
    with pytest.raises(
        ValueError, match=r"FlattenObservations: 'team_sees_box', by which a team's critic sees 'box_obs'"
    ):
        maax.FlattenObservations(critics)
