"""`maax-mjx rollout`: what it prints of episodes, and while it works."""

from __future__ import annotations

import json
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from maax_mjx.cli import main
from maax_mjx.cli.ended import Ended
from maax_mjx.common import progress

GAME = '''
import jax.numpy as jnp
import maax_mjx as maax


class Paid(maax.RewardWrapper):
    """Every agent gains 1 a step."""

    def reward(self, state):
        return jnp.ones(self.base.agents.n_max)


def paid(config: maax.StandardConfig):
    return Paid(maax.make("standard", config))
'''
SMALL = ["--env.horizon=4", "--env.scenario=empty", "--env.n_boxes=0", "--env.n_ramps=0", "--impl=c"]


@pytest.fixture
def game(tmp_path, monkeypatch):
    """The command of a rollout of `GAME`, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "game.py").write_text(GAME)
    monkeypatch.setattr(sys.modules["maax_mjx.cli.rollout"], "_write", lambda *_: ["a.file"])
    return ["rollout", "game.py:paid", *SMALL]


def test_sums_of_episodes_that_ended():
    """One of three worlds is done at the first step, where its second agent does not play; another at the second."""
    done = jnp.array([[True, False, False], [False, True, False]])
    active = jnp.ones((2, 3, 2), bool).at[0, 0, 1].set(False)
    returns = jnp.arange(12.0).reshape(2, 3, 2)
    ended = Ended.none(2).plus(Ended.of(done, active, returns, jnp.array([[3, 9, 9], [9, 4, 9]])))
    assert ended.mean_return(["a", "b"]) == {"a": (0 + 8) / 2, "b": 9.0}
    assert ended.mean_length == 3.5
    alone = Ended.of(done[:1], active[:1], returns[:1], jnp.array([[3, 9, 9]]))
    assert Ended.none(2).plus(alone).mean_return(["a", "b"]) == {"a": 0.0}, "the other one played in none"
    assert all(np.shape(a) == np.shape(b) for a, b in zip(alone, Ended.none(2), strict=True))


@pytest.mark.parametrize("policy", [[], ["--policy", "still"]])
def test_the_mean_return_is_of_episodes_that_ended(game, policy, capsys):
    """Of horizon 4, staggered over four worlds: in six steps end those of 4; 3; 2, 4; and 1, 4 steps."""
    main([*game, "--worlds=4", "--steps=6", "--json", *policy])
    told = json.loads(capsys.readouterr().out)
    assert told["episodes"] == 6
    assert told["mean_return"] == dict.fromkeys(told["mean_return"], 3.0)
    assert told["mean_length"] == 3.0


def test_without_an_end_there_is_no_mean_return(game, capsys):
    main([*game, "--worlds=1", "--steps=2"])
    told = capsys.readouterr().out
    assert "mean return       none: no episode ended" in told
    assert "mean return of" not in told


def test_a_log_has_every_line_once(game, capsys, monkeypatch):
    """A compilation of more than ten seconds does not repeat its line."""
    monkeypatch.setattr(progress, "SECONDS", 0.0)
    main([*game, "--worlds=1", "--steps=4"])
    told = capsys.readouterr()
    lines = told.err.splitlines()
    assert lines[0] == "compiling for c: 0/4 steps"
    assert not any(line.startswith("compiling") for line in lines[1:])
    assert "1, after 4 steps on average" in told.out
    assert "of the episode that ended: " in told.out
