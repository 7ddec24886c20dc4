"""What `maax-mjx train` says of a call at its end."""

from __future__ import annotations

import math
from importlib import import_module
from types import SimpleNamespace

from maax_mjx import training

cli = import_module("maax_mjx.cli.train")  # the package has the function of that name


def progress(i, seconds, episodes, caught, **speed):
    """A run of 100 steps an iteration, 50 of them before this call."""
    counts = {"episodes": episodes + 1, "whole_episodes": episodes, "ended_hiders": 2 * episodes, "broken": 0.0}
    if not episodes:
        caught = math.nan
    metrics = {**counts, "return_hiders": -10 * caught, "episode_caught": caught, **speed}
    return training.Progress(50 + i, 100 * (50 + i), 600.0 + seconds, metrics)


def ended(folder, *made):
    result = cli._result(training.Run(folder, SimpleNamespace(steps=7), made[-1]), [made[0], made[-1]], made)
    return result, cli._rows(result)


def test_speed_is_of_the_call_and_means_are_weighted_by_episodes(tmp_path):
    """The last iteration saved, which took nine seconds, and a single episode ended in it."""
    last = progress(3, 10.0, 1.0, 1.0, env_steps_per_s=11.1)
    result, rows = ended(tmp_path, progress(1, 0.0, 0.0, 0.0, compile_s=9.0), progress(2, 1.0, 3.0, 0.2), last)
    assert result["env_steps_per_s"] == 20, "200 steps in ten seconds: the first iteration has no time"
    assert (result["episode_caught"], result["return_hiders"]) == (0.4, -4.0)
    assert (result["recent_iterations"], result["recent_episodes"]) == (3, 4)
    assert rows["env steps"] == "5,300"
    assert rows["training"] == "10.17 min of the run, without compilation"
    assert rows["speed"] == "20 env steps/s in this call"
    assert rows["mean return"] == "hiders -4 for each agent, of the 4 episodes that ended in the last 3 iterations"
    assert rows["caught"] == "in 0.4 of the steps after preparation, in these episodes"


def test_what_a_single_iteration_does_not_tell_is_no_number(tmp_path):
    result, rows = ended(tmp_path, progress(1, 0.0, 0.0, 0.0, compile_s=9.0))
    assert [result[name] for name in ("env_steps_per_s", "return_hiders", "episode_caught")] == [None] * 3
    assert rows["speed"] == "not measured: one iteration, which compiled"
    assert rows["mean return"] == "none: no whole episode ended in the last iteration"
    assert "caught" not in rows


def test_means_are_over_what_counted_and_updates_that_were_skipped_are_told(tmp_path):
    """Where past opponents played the hiders in all episodes there is no number for them."""
    mine, theirs = progress(1, 0.0, 3.0, 0.2), progress(2, 1.0, 1.0, 0.6, ended_hiders=0.0, return_hiders=math.nan)
    result, rows = ended(tmp_path, mine, theirs)
    assert (result["return_hiders"], result["episode_caught"]) == (-2.0, 0.3)
    assert "skipped" not in rows
    theirs.metrics["broken"] = 0.25
    result, rows = ended(tmp_path, theirs)
    assert result["return_hiders"] is None
    assert rows["mean return"] == "hiders none for each agent, of the one episode that ended in the last iteration"
    assert rows["skipped"] == "0.25 of the updates in the last iteration: not finite, as of NaN in a reward"


def test_nothing_gained_has_no_minus(tmp_path):
    _, rows = ended(tmp_path, progress(1, 0.0, 2.0, 0.00001))
    assert rows["mean return"] == "hiders +0 for each agent, of the 2 episodes that ended in the last iteration"


def test_files_are_those_of_the_folder(tmp_path):
    for name in ("past", "saves", "learner"):
        (tmp_path / name).mkdir()
    for name in ("run.json", "metrics.jsonl", "policy"):
        (tmp_path / name).touch()
    run = training.Run(tmp_path, SimpleNamespace(steps=7), None)
    assert cli._rows(cli._result(run, [], [])) == {
        "folder": str(tmp_path),
        "env steps": "7",
        "files": "run.json, metrics.jsonl, policy, past/, saves/, learner/",
    }
