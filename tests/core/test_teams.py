"""Teams have names, and agents are called by them."""

import pickle

import jax
import numpy as np
import pytest
from helpers.seeds import key

import maax_mjx as maax
from maax_mjx.core.teams import member_of
from maax_mjx.wrappers import find


@pytest.mark.parametrize(
    ("name", "fields", "teams", "agents"),
    [
        ("hide_and_seek", {}, {"hiders": (0, 1), "seekers": (2, 3)}, "hider_0 hider_1 seeker_0 seeker_1"),
        ("hide_and_seek", {"n_hiders": (0, 1), "n_seekers": (1, 2)}, {"hiders": (0,), "seekers": (1, 2)},
         "hider_0 seeker_0 seeker_1"),
        ("standard", {"n_seekers": 0}, {"hiders": (0, 1)}, "hider_0 hider_1"),
        ("tag", {}, {"players": (0, 1, 2, 3)}, "player_0 player_1 player_2 player_3"),
        ("tag", {"teams": {"cats": 1, "sheep": 2}}, {"cats": (0,), "sheep": (1, 2)}, "cat_0 sheep_0 sheep_1"),
        ("capture_the_flag", {}, {"blues": (0, 1), "reds": (2, 3)}, "blue_0 blue_1 red_0 red_1"),
    ],
)  # fmt: skip
def test_every_game_names_its_teams(name, fields, teams, agents):
    env = maax.make(name, impl="c", **fields)
    assert {team.name: team.slots for team in env.teams.values()} == teams
    assert list(env.teams) == list(teams)
    assert " ".join(env.agent_names) == agents
    assert all(team.n_agents == len(team.slots) for team in env.teams.values())
    assert len({team.colour for team in env.teams.values()}) == len(teams)


@pytest.mark.slow
def test_numbers_of_teams_are_ranges():
    env = maax.make("tag", impl="c", teams={"players": (2, 5)}, agent_placement={"players": "uniform"})
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(key(0), 200))
    counts = np.asarray(states.world.active["agent"].sum(axis=1))
    assert set(counts.tolist()) == {2, 3, 4, 5}
    pinned = env.default_params.replace(n_players=3)
    assert int(env.reset(key(0), pinned).world.active["agent"].sum()) == 3


def test_an_item_of_a_mapping_is_overridden_by_its_dotted_name():
    assert maax.make("capture_the_flag", impl="c", **{"teams.reds": 3}).agent_names[-1] == "red_2"
    with pytest.raises(ValueError, match=r"teams: got 'blue'; did you mean 'blues'.*takes one of"):
        maax.make("capture_the_flag", **{"teams.blue": 3})


def test_membership_names_teams_of_its_own():
    base = maax.make("standard", impl="c")
    assert list(maax.TeamMembership(base).teams) == ["hiders", "seekers"]
    other = maax.TeamMembership(base, [0, 1, 1, 2])
    assert list(other.teams) == ["team_0", "team_1", "team_2"]
    assert other.agent_names == ("team_0_0", "team_1_0", "team_1_1", "team_2_0")
    named = maax.TeamMembership(base, [0, 1, 0, 1], names=["cats", "dogs"])
    assert named.agent_names == ("cat_0", "dog_0", "cat_1", "dog_1")
    assert maax.LineOfSight(named).teams == named.teams


def test_singular():
    assert [member_of(name) for name in ("hiders", "red", "s", "boss")] == ["hider", "red", "s", "boss"]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: maax.Agents({"hiders": 2, "seekers": 0}), "n_agents: got no agents in team 'seekers'"),
        (lambda: maax.Agents({}), "n_agents: got no teams"),
        (lambda: maax.make("tag", teams={}), "teams: got {}"),
        (lambda: maax.make("tag", teams={"players": 0}), "teams: got no agents in 'players'"),
        (lambda: maax.make("tag", teams=4), "teams: got 4"),
        (lambda: maax.make("tag", teams={"a": 1}, agent_placement={"b": "uniform"}), r"agent_placement: got \['b'\]"),
        (lambda: maax.TeamMembership(maax.make("standard"), [0, 0, 2, 2]), "teams: got 'team_1' without agents"),
        (lambda: maax.TeamMembership(maax.make("standard"), names=["a", "a"]), "teams: got 'a' twice"),
        (lambda: maax.TeamMembership(maax.make("standard"), names=["a"]), r"names: got \['a'\]; takes 2"),
        (lambda: maax.make("tag", teams={"hider": 1, "hiders": 1}), "whose agents have the same names"),
        (lambda: maax.TeamMembership(maax.make("standard"), names=["", "x"]), "teams: got the name ''"),
        (lambda: maax.make("capture_the_flag", teams={"a": 1}), "agent_placement: got 2; takes 1"),
        (lambda: maax.make("standard", n_hiders=0, n_seekers=0), "at least one agent in all"),
    ],
)
def test_bad_input(make, says):
    with pytest.raises(ValueError, match=says):
        make()


@pytest.mark.slow
@pytest.mark.parametrize(("fields", "seekers"), [({"n_hiders": 0}, [0, 1]), ({"n_seekers": 0}, [])])
def test_a_side_alone_is_still_that_side(fields, seekers):
    """Seekers without hiders do not become the first team, which hides."""
    env = maax.make("hide_and_seek", impl="c", observations="raw", prep_fraction=0.5, horizon=4, **fields)
    waits = find(env, maax.PreparationPhase).seekers
    assert np.flatnonzero(waits).tolist() == seekers
    state, step = jax.jit(env.reset)(key(0)), jax.jit(env.step)
    action = jax.tree.map(np.zeros_like, jax.device_get(env.sample_action(key(0))))
    for _ in range(3):
        state = step(state, action)
    np.testing.assert_array_equal(state.reward, [-1 if slot in seekers else 1 for slot in range(2)])


def test_colours_by_team():
    red = (0.8, 0.1, 0.1, 1.0)
    agents = maax.Agents({"reds": 2, "blues": (1, 2)}, colours={"reds": red})
    default = maax.Agents({"reds": 2, "blues": (1, 2)})
    np.testing.assert_array_equal(agents.colours[:2], [red, red])
    np.testing.assert_array_equal(agents.colours[2:], default.colours[2:])
    with pytest.raises(ValueError, match=r"^colours: got 'greens'; did you mean 'reds'"):
        maax.Agents({"reds": 2, "blues": 2}, colours={"greens": red})


def test_a_team_that_is_not_there_is_answered_with_those_that_are(env_c):
    with pytest.raises(KeyError, match=r"teams: got 'greens'; takes one of \['hiders', 'seekers'\]"):
        env_c.teams["greens"]
    assert pickle.loads(pickle.dumps(env_c.teams)) == env_c.teams
