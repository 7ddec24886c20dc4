"""The benchmark of trainers side by side, with a learner that takes no time."""

from __future__ import annotations

import time

import pytest

from maax_mjx.benchmarks import learners


def learn_slowly(config, seed, clock):
    """Twenty updates in the time, each ten env steps, whose reward is what was learnt so far."""
    for i in range(1000):
        time.sleep(config.seconds / 20)
        clock.note(10 * (i + 1), i / 1000)


def test_rows_say_what_was_reached_in_the_time(run, folder, monkeypatch):
    monkeypatch.setitem(learners.LEARNERS, "maax", learn_slowly)
    (row,) = run(learners, folder / "learners_cpu.json", learner=("maax",), seconds=0.4)
    assert 0.4 <= row["seconds"] < 0.8
    assert row["first"] == 0
    # The last tenth of at most twenty updates after the first one.
    assert 0.008 < row["last"] <= 0.02
    assert row["env_steps_per_s"] <= 10 * 20 / 0.4
    assert row["compile_s"] == pytest.approx(0.0, abs=0.2)


def test_the_page_has_the_game_and_the_learners():
    names = learners.block("class ActorCritic")
    assert {"Gather", "update", "train"} <= set(names)
    assert "params" not in names, "nothing was trained"


def test_a_script_without_its_checkout_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"jaxmarl: got None with mappo_rnn_mpe; takes the folder of a checkout"):
        learners.Config(learner=("mappo_rnn_mpe",)).check()
    with pytest.raises(ValueError, match="learner: got 'ppo'"):
        learners.Config(learner=("ppo",)).check()
