"""`maax-mjx train`, `evaluate` and `rollout --policy`, one after the other as a user would."""

from __future__ import annotations

import importlib
import json
import signal
import time

import pytest

from maax_mjx import training
from maax_mjx.cli import main

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("made_once")]

SMALL = ["--worlds", "4", "--net.encoder", "flat", "--net.core", "none", "--net.hidden", "8"]
SMALL += ["--ppo.unroll", "4", "--ppo.chunk", "4", "--ppo.epochs", "1", "--ppo.minibatches", "1"]
GAME = ["--env.n_boxes", "0", "--env.n_ramps", "0", "--env.horizon", "8", "--env.scenario", "empty"]


def printed(capsys, *words):
    """What a command prints as JSON."""
    main([*words, "--json"])
    return json.loads(capsys.readouterr().out)


def test_a_game_is_learnt_gone_on_with_evaluated_and_watched(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = printed(
        capsys, "train", "tag", *SMALL, *GAME, "--steps", "32", "--out", "runs/tag", "--tensorboard", "True"
    )
    assert (first["iterations"], first["steps"]) == (2, 32)
    folder = tmp_path / "runs" / "tag"
    assert {"run.json", "metrics.jsonl", "curves.png", "policy", "past", "replay.html", "tensorboard"} <= {
        file.name for file in folder.iterdir()
    }
    iterate = training.Trainer._iteration
    made = []

    def interrupted(self, first):
        made.append(iterate(self, first))
        if len(made) == 2:
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.3)  # for the thread that listens
        return made[-1]

    monkeypatch.setattr(training.Trainer, "_iteration", interrupted)
    with pytest.raises(SystemExit) as error:
        main(["train", "runs/tag", "--steps", "4800", "--json"])
    monkeypatch.setattr(training.Trainer, "_iteration", iterate)
    assert error.value.code == 130
    more = json.loads(capsys.readouterr().out)
    assert (more["iterations"], more["steps"]) == (4, 64), "it ended after the iteration that ran, and told"
    assert training.Policy.load(folder).steps == 64
    assert len(list((folder / "tensorboard").iterdir())) == 2, "it goes on with what it was begun with"
    matches = printed(capsys, "evaluate", "runs/tag", "--against", "random", "--episodes", "4", "--impl", "c")
    assert [match["opponent"] for match in matches] == ["random"] * len(matches)
    seen = printed(capsys, "rollout", "tag", "--policy", "runs/tag", "--worlds", "4", "--steps", "8", "--impl", "c")
    assert seen["policy"] == "runs/tag"
    assert seen["episodes"] >= 4
    for words, said in (
        (["train", "tagg"], "got 'tagg'; did you mean 'tag'"),
        (["train", "runs/tag", "--env.n_boxes", "2", "--steps", "64"], "takes it with a new run"),
        (["train", "runs/tag", "--preset", "gpu", "--steps", "640"], "--preset: got it with the folder of a run"),
        (["train", "runs/tag", "--seed", "4", "--steps", "640"], "--seed: got it with the folder of a run"),
        (["train", "runs/tag", "--out", "runs/new", "--steps", "640"], "--out: got it with the folder of a run"),
        (["train", "runs/tag", "--from", "tag/trained", "--steps", "640"], "--from: got it with the folder of a run"),
        (["train", "runs/tag", "--transfer", "--steps", "640"], "--transfer: got it with the folder of a run"),
        (
            ["train", "tag", "--preset", "laptop", "--out", "runs/tag", "--steps", "640"],
            "env.horizon=8, not 1000; env.n_boxes=0, not [1, 3]; env.n_ramps=0, not 1; takes that run's, "
            "or another folder (--out)",
        ),
        (["train", "tag", "--ppo.lr", "-1"], "ppo.lr: got -1"),
        (["train", "tag", "--from", "runs/none"], "from: got 'runs/none', which is not there"),
        (
            ["train", "tag", *SMALL, "--out", "runs/new", "--from", "tag/trained"],
            "net.encoder=pool, not flat; net.width=128, not 32; net.hidden=256, not 8; net.share=all, not team; takes",
        ),
        (["rollout", "hide_and_seek", "--policy", "runs/tag"], "takes one of the same game"),
        (["rollout", "tag", "--policy", "chasse"], "did you mean 'chase'?"),
        (["rollout", "standard", "--policy", "close_door"], "close_door: got a game without boxes that can be grabbed"),
        (["evaluate", "runs/tag", "--against", "runs/none"], "runs/none"),
    ):
        with pytest.raises(SystemExit) as error:
            main(words)
        assert error.value.code == 2
        told = capsys.readouterr().err
        assert said in told, words
        assert "compiling" not in told, words
    assert not (tmp_path / "runs" / "new").exists()


def test_a_run_that_has_its_steps_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["tag", *SMALL, *GAME, "--steps", "16", "--out", "run"]
    printed(capsys, "train", *words)
    main(["train", *words])
    told = capsys.readouterr()
    assert "the run has 16 steps already, and steps count all of them" in told.err
    assert "compiling" not in told.err
    assert "16" in told.out
    main(["train", *words, "--ppo.lr", "1e-4"])
    assert "goes on" not in capsys.readouterr().err


def test_another_engine_is_told_and_kept(tmp_path, capsys, monkeypatch):
    """With the name of the folder alone; nothing else of the game may be given there."""
    monkeypatch.chdir(tmp_path)
    printed(capsys, "train", "tag", *SMALL, *GAME, "--steps", "16", "--out", "run", "--save-worlds", "False")

    def saved(self, *_):
        self.save()
        return training.Run(self.folder.path, self.policy, None)

    monkeypatch.setattr(training.Trainer, "run", saved)
    monkeypatch.setattr(importlib.import_module("maax_mjx.cli.train"), "_replay", lambda *_: None)
    main(["train", "run", "--steps", "32", "--env.impl", "jax"])
    assert "goes on with env.impl=jax, not c" in capsys.readouterr().err
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert about["game"]["config"]["impl"] == "jax"
    assert [change["settings"] for change in about["changes"]] == [{"env.impl": "jax"}]
    main(["train", "run", "--steps", "32"])
    assert "goes on with" not in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["train", "run", "--env.horizon", "9"])
    assert "--env.horizon: got it with the folder of a run" in capsys.readouterr().err


def test_a_rollout_takes_scripted_players_and_a_runs_past(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = ["--worlds", "2", "--steps", "4", "--impl", "c"]
    still = printed(capsys, "rollout", "tag", *GAME, *short, "--policy", "still")
    assert still["policy"] == "still"
    printed(capsys, "train", "tag", *SMALL, *GAME, "--steps", "16", "--out", "run")
    assert printed(capsys, "rollout", "tag", *short, "--policy", "run@0")["policy"] == "run@0"


def test_an_evaluation_says_what_it_plays(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed(capsys, "train", "tag", *SMALL, *GAME, "--steps", "16", "--out", "run")
    main(["evaluate", "run", "--against", "still", "random", "--episodes", "2", "--impl", "c"])
    told = capsys.readouterr()
    assert "players against still: 0/2 matches" in told.err
    assert "players against random: 1/2 matches" in told.err
    assert told.out.startswith("team ")
