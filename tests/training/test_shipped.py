"""Policies that come with the package: their files, their names, and that they do what their names say."""

from __future__ import annotations

import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from flax import serialization

from maax_mjx import training
from maax_mjx.training.evaluate import _title
from maax_mjx.training.shipped import FOLDER, file_of

BYTES = 2_000_000
"""Of one policy, at most."""


def test_all_are_small_and_load():
    names = training.policies()
    assert {
        "capture_the_flag/near",
        "capture_the_flag/trained",
        "full/boxes",
        "full/ramps",
        "hide_and_seek_food/trained",
        "lock_all/trained",
        "lock_and_return/trained",
        "lock_order/trained",
        "quadrant/box_blocking",
        "quadrant/chase",
        "quadrant/forts",
        "quadrant/ramps",
        "quadrant/ramp_defence",
        "tag/trained",
        "hide_and_seek/per_team",
    } <= set(names)
    for name in names:
        assert (FOLDER / f"{name}.policy").stat().st_size < BYTES
        policy = training.Policy.load(name)
        assert policy.steps > 0
        assert policy.game
        assert {np.asarray(x).dtype for x in jax.tree.leaves(policy.params)} == {np.dtype(np.float32)}
        assert not policy.params.critic


def test_small_files_are_near_the_policy(tmp_path):
    policy = training.Policy.load("quadrant/forts")
    policy.save(tmp_path / "large")
    policy.save(tmp_path / "small", small=True)
    assert (tmp_path / "small").stat().st_size < 0.51 * (tmp_path / "large").stat().st_size
    again = training.Policy.load(tmp_path / "small")
    jax.tree.map(np.testing.assert_array_equal, again.params, policy.params)


def test_moments_keep_their_digits_in_small_files(tmp_path):
    """A variance is a small difference of two of them."""
    policy = training.Policy.load("quadrant/forts")
    moments = {"mean": np.float32([1.0, 1000.1]), "square": np.float32([1.0, 1000200.1])}
    training.Policy(policy.network, policy.params.replace(norm=moments)).save(tmp_path / "small", small=True)
    written = serialization.msgpack_restore((tmp_path / "small").read_bytes())["weights"]
    jax.tree.map(np.testing.assert_array_equal, written["norm"], moments)
    assert {x.dtype for x in jax.tree.leaves(written["actor"])} == {np.dtype(np.float16)}


def test_what_is_there_comes_before_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert file_of(Path("quadrant/forts")).is_relative_to(FOLDER)
    (tmp_path / "quadrant").mkdir()
    (tmp_path / "quadrant" / "forts").write_text("")
    assert file_of(Path("quadrant/forts")) == Path("quadrant/forts")
    with pytest.raises(ValueError, match="quadrant/forts, which is no policy"):
        training.Policy.load("quadrant/forts")


@pytest.mark.parametrize("name", ["quadrant/fort", "quadrant", "../quadrant/forts", "quadrant/forts.policy"])
def test_unknown_names_are_refused_with_the_known_ones(name):
    with pytest.raises(
        ValueError,
        match=r"which is not there( \(did you mean '[a-z_/]+'\?\))?; "
        r"takes .* one of \['blueprint/trained', .*'quadrant/forts', .*'tag/trained'\]",
    ):
        training.Policy.load(name)
    with pytest.raises(ValueError, match="against: got"):
        training.player_of("against", name)


def test_games_of_ones_own_are_made_where_their_file_is():
    policy = training.Policy.load("tag/trained")
    policy.game = {"game": "not_here.py:football", "config": {}}
    with pytest.raises(ValueError, match=r"'not_here\.py:football', and there is no file .*, from this folder$"):
        policy.make_env()
    policy.game = {"game": "football", "config": {}}
    with pytest.raises(ValueError, match=r"first, or train it by its file's name, my_game\.py:football$"):
        policy.make_env()


def test_the_nearest_name_is_suggested():
    with pytest.raises(ValueError, match=r"which is not there \(did you mean 'quadrant/forts'\?\); takes"):
        training.Policy.load("quadrant/fort")


@pytest.mark.slow
def test_they_do_what_their_names_say():
    """Chasing seekers see hiders nearly always; hiders in forts are nearly never seen."""
    chase, forts = (training.Policy.load(f"quadrant/{name}") for name in ("chase", "forts"))
    env = forts.make_env(impl="c")
    seen = {
        name: training.evaluate(policy, ["self"], 24, env, teams=["seekers"]).matches[0].metrics["caught"].mean
        for name, policy in (("chase", chase), ("forts", forts))
    }
    assert seen["chase"] > 0.75
    assert seen["forts"] < 0.3


@pytest.mark.slow
def test_box_blocking_shuts_doors_and_forts_do_not():
    """The free gap of 0.92 and of none of the doors is below 0.3 m when preparation ends."""
    policies = [training.Policy.load(f"quadrant/{name}") for name in ("box_blocking", "forts")]
    env = policies[0].make_env(impl="c", tools=True)
    shut = [
        training.evaluate(policy, ["self"], 24, env, teams=["hiders"]).matches[0].metrics["doors_blocked_prep"].mean
        for policy in policies
    ]
    assert shut[0] > 0.7
    assert shut[1] < 0.1


@pytest.mark.slow
def test_players_of_tag_beat_random_ones():
    env = training.Policy.load("tag/trained").make_env(impl="c")
    (match,) = training.evaluate("tag/trained", ["random"], 24, env).matches
    assert match.won.mean > 0.75


@pytest.mark.slow
def test_hiders_and_seekers_beat_scripted_ones():
    """Whichever team they play."""
    env = training.Policy.load("hide_and_seek/per_team").make_env(impl="c")
    for match in training.evaluate("hide_and_seek/per_team", ["chase"], 24, env).matches:
        assert match.won.mean > 0.85


def test_all_opponents_are_looked_at_before_the_first_match(monkeypatch):
    monkeypatch.setattr(
        sys.modules["maax_mjx.training.evaluate"], "_match", lambda *args: pytest.fail("a match was played")
    )
    env = training.Policy.load("tag/trained").make_env(impl="c", horizon=3)
    with pytest.raises(ValueError, match="against: got 'chaes', and nothing is there"):
        training.evaluate("tag/trained", ["random", "chaes"], 2, env)
    with pytest.raises(ValueError, match=r"^against: got 'quadrant/forts', which cannot play here; policy: "):
        training.evaluate("tag/trained", ["quadrant/forts"], 2, env)
    with pytest.raises(ValueError, match=r"against: got 'random'; takes a list, such as \['random'\]"):
        training.evaluate("tag/trained", "random", 2, env)


def test_a_past_policy_is_called_by_the_steps_that_it_has():
    policy = training.Policy.load("quadrant/forts")
    assert _title("runs/x@1G", policy) == f"runs/x@{policy.steps / 1e6:.4g}M"
    assert _title("quadrant/forts", policy) == "quadrant/forts"
    assert _title("chase", training.SCRIPTED["chase"]) == "chase"
    assert _title(policy, policy) == repr(policy)
