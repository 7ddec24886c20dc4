"""The benchmarks of training at their smallest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers import toys

from maax_mjx import training
from maax_mjx.benchmarks import compare, learning, matches, stages, train_speed
from maax_mjx.training import config


@pytest.mark.slow
def test_train_speed(run, folder, monkeypatch):
    toys.register()
    monkeypatch.setitem(config.PRESETS, "laptop", training.preset("laptop", {"net.share": "all"}))
    options = {"env": ("echo",), "impl": ("c",), "worlds": (4,), "preset": "laptop", "turns": 1, "minibatches": (2,)}
    nets = {"encoder": ("flat",), "core": ("none",), "epochs": (1,)}
    rows = run(train_speed, folder / "train_speed_cpu.json", **options, **nets)
    assert [(row["part"], row["encoder"], row["core"], row["epochs"], row["minibatches"]) for row in rows] == [
        ("env", "", "", 0, 0), ("play", "flat", "none", 0, 0), ("train", "flat", "none", 1, 2),
    ]  # fmt: skip
    for row in rows:
        assert row["unroll"] == 40
        assert 0 < row["env_steps_per_s"] <= row["fastest"]


def test_what_a_part_does_not_have_is_not_varied():
    """The environment alone has no networks, and play no updates, so that they are timed once and once each."""
    several = train_speed.Config(encoder=("flat", "pool"), epochs=(1, 2))
    assert [(case.part, case.encoder, case.epochs) for case in train_speed.cases(several)] == [
        ("env", "", 0), ("play", "flat", 0), ("train", "flat", 1), ("train", "flat", 2), ("play", "pool", 0),
        ("train", "pool", 1), ("train", "pool", 2),
    ]  # fmt: skip


@pytest.mark.slow
def test_train_speed_of_a_policy_without_a_critic(run, folder):
    """Its networks are timed, with a critic that is drawn; rows of it are others than those of untrained networks."""
    policy = "tag/trained"
    options = {"env": ("tag",), "impl": ("c",), "worlds": (16,), "turns": 1, "part": ("train",), "epochs": (1,)}
    rows = run(train_speed, folder / "train_policy_cpu.json", **options, encoder=("flat",), policy=Path(policy))
    net = training.Policy.load(policy).network.net
    assert [(row["policy"], row["encoder"], row["core"]) for row in rows] == [(policy, net.encoder, net.core)]


@pytest.mark.slow
@pytest.mark.usefixtures("made_once")
def test_learning(run, folder, monkeypatch):
    """In the smallest game of hiders and seekers; a run that has had its minutes is not trained again."""
    small = {"net.encoder": "flat", "net.hidden": 8, "net.share": "all", "worlds": 4, "ppo.unroll": 10, "ppo.chunk": 10}
    env = {
        "n_boxes": 0,
        "n_ramps": 0,
        "lock": None,
        "scenario": "empty",
        "horizon": 10,
        "impl": "c",
        "observations": "ego",
    }
    small |= {"ppo.minibatches": 2, "league.share": 0.0}
    tiny = replace(training.preset("laptop", small), env=env)
    monkeypatch.setitem(config.PRESETS, "laptop", tiny)
    options = {"env": ("hide_and_seek",), "seeds": (3,), "minutes": (0.0001,), "episodes": 8, "runs": folder / "runs"}
    (row,) = run(learning, folder / "learning_cpu.json", **options)
    assert row["seed"] == 3
    assert row["steps"] % 40 == 0
    assert 0 <= row["random"] <= 1
    assert row["gain"] == pytest.approx(row["seekers"] - row["random"], abs=1e-3)
    (again,) = run(learning, folder / "again_cpu.json", **options)
    assert again["steps"] == row["steps"]
    assert again["seekers"] == row["seekers"]
    (trained,) = (folder / "runs").iterdir()
    (played,) = run(stages, folder / "stages_cpu.json", runs=(trained,), without=("nothing",), episodes=4, impl="c")
    assert (played["run"], played["steps"], played["without"]) == (trained.name, row["steps"], "nothing")
    assert played["stage"] == ""
    assert played["trained"] > 0
    assert 0 <= played["numbers"]["enclosed_prep"][0] <= 1


def test_policies_of_a_run_are_played_from_the_oldest_to_the_newest(folder):
    """The one of the beginning has learnt nothing, and the newest may be among the past ones as well."""
    policy = training.Policy.load("quadrant/chase")
    (folder / "run" / "past").mkdir(parents=True)
    (folder / "run" / "run.json").write_text("{}")
    policy.save(folder / "run" / "policy")
    for steps in (0, 5_000_000, policy.steps):
        policy.save(folder / "run" / "past" / f"{steps:015d}")
    both = stages.Config(runs=(folder / "run",), without=("nothing", "no_ramps"))
    assert [(case.run, case.steps, case.without) for case in stages.cases(both)] == [
        ("run", steps, without) for steps in (5_000_000, policy.steps) for without in ("nothing", "no_ramps")
    ]
    assert [case.steps for case in stages.cases(replace(both, past=False, without=("nothing",)))] == [policy.steps]
    assert {case.changed for case in stages.cases(both)} == {""}


def test_a_policy_is_played_in_its_game_with_other_values(folder):
    (folder / "other").mkdir()
    (folder / "other" / "run.json").write_text("{}")
    training.Policy.load("quadrant/chase").save(folder / "other" / "policy")
    change = ("p_door_dropout=1", "hider_placement=quad", "n_boxes=1,2")
    config = stages.Config(runs=(folder / "other",), without=("no_ramps",), change=change)
    config.check()
    (case,) = stages.cases(config)
    assert case.changed == "p_door_dropout=1 hider_placement=quad n_boxes=1,2"
    for without in ("nothing", "no_ramps"):
        found = stages.game_of(folder / "other", without, change, "c").made_from.config
        assert (found.p_door_dropout, found.hider_placement, found.n_boxes) == (1, "quad", (1, 2))
    for wrong in ("p_door_dropout", "=1", "p_door_dropout=", "a b=1"):
        with pytest.raises(ValueError, match=r"change: got .*; takes a field and its value"):
            replace(config, change=(wrong,)).check()


def test_opponents_that_cannot_play_a_game_are_left_out_and_unknown_ones_refused():
    config = matches.Config(policies=("tag/trained",), against=("tag", "capture_the_flag", "quadrant/forts"), impl="c")
    (case,) = matches.cases(config)
    assert (case.against, case.team, case.against_steps) == ("tag", "players", 0)
    # Rows of a policy that has learnt on since are others.
    assert case.steps == training.Policy.load("tag/trained").steps
    quadrant = matches.Config(policies=("quadrant/forts",), against=("quadrant/chase", "self"), impl="c")
    steps = [(case.against, case.against_steps) for case in matches.cases(quadrant) if case.team == "hiders"]
    assert steps == [("quadrant/chase", training.Policy.load("quadrant/chase").steps), ("self", 0)]
    with pytest.raises(ValueError, match="against: got 'tagg'"):
        list(matches.cases(replace(config, against=("tagg",))))


def test_curves_leave_out_iterations_in_which_nothing_counted():
    rows = [
        {"steps": 10, "episodes": 5.0, "whole_episodes": 1.0, "episode_caught": 0.2},
        {"steps": 20, "episodes": 5.0, "whole_episodes": 3.0, "episode_caught": 0.6},
        {"steps": 30, "episodes": 5.0, "whole_episodes": 0.0, "episode_caught": None},
        {"steps": 40, "episodes": 4.0, "episode_caught": 0.9},  # of an older run
    ]
    assert compare.curve_of(rows, "episode_caught", 20) == [(20, 0.5), (40, 0.9)]
    assert compare.curve_of(rows[2:3], "episode_caught", 20) == []
