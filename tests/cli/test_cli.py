"""The command line as a user calls it: what it writes, prints, refuses, and how it ends."""

from __future__ import annotations

import dataclasses
import inspect
import io
import json
import re
import signal
import subprocess
import sys
import time
from importlib import metadata
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from helpers import seeds
from PIL import Image

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.benchmarks import BENCHMARKS
from maax_mjx.cli import COMMANDS, main, saved
from maax_mjx.cli.options import apart, as_learnt, config_with, split_overrides
from maax_mjx.cli.saved import load
from maax_mjx.cli.worlds import parse_placement
from maax_mjx.common.options import number_of, value_of
from maax_mjx.core.identity import about_game, difference
from maax_mjx.parallel.recording import read, write
from maax_mjx.tasks.config import inner_config
from maax_mjx.training.run import NotFiniteError


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """A rollout of a game with fields of its config given, and what it printed for machines."""
    folder = tmp_path_factory.mktemp("rollout")
    printed = folder / "printed"
    fields = ["--env.n_boxes", "1,2", "--env.n-ramps=0", "--env.grab", "True", "--env.grab.exclusive", "True"]
    fields += ["--env.scenario", "empty"]
    with printed.open("w") as file, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", file)
        main(["rollout", "hide_and_seek", "--worlds=6", "--steps=20", "--show=2", "--json", f"--out={folder}", *fields])
    return folder, json.loads(printed.read_text())


@pytest.mark.slow
def test_rollout_writes_what_it_says(played):
    folder, result = played
    assert (result["env"], result["worlds"], result["steps"], result["interrupted"]) == ("hide_and_seek", 6, 20, False)
    assert result["env_steps_per_s"] > 0
    assert sorted(result["files"]) == sorted(
        str(folder / name) for name in ("worlds.png", "rollout.gif", "rollout.npz", "world.xml", "replay.html")
    )
    assert np.asarray(Image.open(folder / "worlds.png")).std() > 10
    assert Image.open(folder / "rollout.gif").n_frames == 3
    assert (folder / "replay.html").read_text().startswith("<!")
    model = mujoco.MjModel.from_xml_path(str(folder / "world.xml"))
    assert model.nkey == 1
    assert model.njnt == 4 * 4 + 2 * 4, "4 agents and 2 boxes, without a ramp"


def test_a_saved_rollout_is_what_was_played(played):
    env, recording = load(played[0] / "rollout.npz")
    grabs = maax.wrappers.find(env, maax.GrabObjects)
    assert grabs is not None
    assert (grabs.exclusive, env.base.modules["box"].n_max) == (True, 2)
    assert recording.states.step.shape == (4, 2)
    assert recording.states.step[:, 0].tolist() == [recording.states.step[0, 0] + i for i in (0, 8, 16, 20)]
    heights = recording.states.data.xpos[:, :, env.base.agents.body_ids, 2]
    assert ((heights > 0.1) & (heights < 0.3)).all()


def test_a_rollout_is_loaded_whatever_engine_it_was_played_on(played, tmp_path):
    env, recording = load(played[0] / "rollout.npz")
    fields = {"n_boxes": "1,2", "n_ramps": "0", "grab": "True", "scenario": "empty", "impl": "warp"}
    saved.save(tmp_path / "other.npz", "hide_and_seek", fields, recording)
    assert load(tmp_path / "other.npz")[0].base.engine.impl == env.base.engine.impl == "c"


def test_a_rollout_keeps_its_game_when_a_default_changes(played, tmp_path):
    _, recording = load(played[0] / "rollout.npz")
    made = maax.make("hide_and_seek", impl="c", n_boxes=(1, 2), n_ramps=0, scenario="empty").made
    about = about_game(made)
    about["defaults"]["horizon"] = 33
    fields = {"maax_mjx": maax.__version__, "env": "hide_and_seek", "overrides": {}, "about": about}
    write(tmp_path / "then.npz", fields, recording)
    assert saved.env_of(tmp_path / "then.npz", "c").base.horizon == 33
    # The command's own file has them.
    meta, _ = read(played[0] / "rollout.npz", saved.TAKES)
    assert meta["about"]["defaults"]["horizon"] == maax.config_of("hide_and_seek").horizon


def test_a_policy_is_played_in_the_game_that_it_learnt():
    """With a group of fields that is None by default, and with the defaults of then."""
    grab = inner_config(type(maax.config_of("hide_and_seek")), "grab")(radius=0.5)
    about = about_game(maax.make("hide_and_seek", impl="c", n_boxes=(1, 2), grab=grab).made)
    about["defaults"]["horizon"] = 33
    texts = as_learnt("hide_and_seek", SimpleNamespace(game=about))
    env = maax.make("hide_and_seek", config_with("hide_and_seek", "c", texts))
    assert maax.config_of(env).n_boxes == (1, 2), "a field of a config of one's own may take tuples alone"
    assert not difference(about, about_game(env.made))
    assert (maax.config_of(env).grab.radius, env.base.horizon, env.base.modules["box"].n_max) == (0.5, 33, 2)


def test_a_run_that_is_never_finite_ends_in_one_sentence(monkeypatch, capsys):
    def stopped(*_, **__):
        raise NotFiniteError("train: 10 iterations in a row had no update that is finite")

    monkeypatch.setattr(training, "Trainer", stopped)
    with pytest.raises(SystemExit) as exited:
        main(["train", "tag", "--steps=100"])
    assert exited.value.code == 2
    assert capsys.readouterr().err.startswith("maax-mjx: train: 10 iterations in a row")


def damaged(data, rng):
    """The bytes of a file with some changed, cut off, or put in."""
    at = int(rng.integers(len(data)))
    if rng.random() < 0.2:
        return data[:at]
    if rng.random() < 0.2:
        return data[:at] + rng.bytes(20) + data[at:]
    # Mostly where the archive says what is in it, and how it is packed.
    at = at if rng.random() < 0.3 else data.index(b"PK\x01\x02") + at % 2000
    return data[:at] + rng.bytes(2) + data[at + 2 :]


def test_damaged_rollouts_are_refused_in_one_sentence(played, tmp_path, monkeypatch):
    """Bytes changed anywhere: the file is refused by a sentence, or loads all the same."""
    path, rng, refused = tmp_path / "rollout.npz", seeds.rng(0), 0
    data = (played[0] / "rollout.npz").read_bytes()
    env, _ = load(played[0] / "rollout.npz")
    monkeypatch.setattr(saved, "make_env", lambda *_: env)
    for _ in range(150):
        path.write_bytes(damaged(data, rng))
        try:
            load(path)
        except ValueError as error:
            refused += 1
            assert str(error).startswith(f"file: got {path}")  # noqa: PT017
            assert "takes" in str(error)  # noqa: PT017
    assert refused > 50


def test_rollouts_of_other_shapes_are_refused(played, tmp_path):
    with np.load(played[0] / "rollout.npz") as file:
        arrays = dict(file)
    name = next(name for name, x in arrays.items() if x.ndim == 3)
    for other in (arrays[name][..., :-1], arrays[name][:1], arrays[name].astype(complex)):
        np.savez(tmp_path / "other.npz", **arrays | {name: other})
        with pytest.raises(ValueError, match=r"without .* as this version has them in this game; takes"):
            load(tmp_path / "other.npz")


def test_a_terminal_without_a_sign_shows_another(monkeypatch):
    shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding="ascii", write_through=True))
    main(["--version"])
    print("1 ± 2")
    assert shown.getvalue().endswith(b"\n1 ? 2\n")


def test_replay_of_worlds_that_were_not_kept(played, capsys):
    with pytest.raises(SystemExit):
        main(["replay", str(played[0] / "rollout.npz"), f"--out={played[0]}/none.gif", "--worlds", "0", "2"])
    assert "worlds: got [0, 2]; takes numbers below 2, of the worlds in " in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["html", "png"])
def test_replay(played, kind, capsys):
    folder, _ = played
    main(["replay", str(folder / "rollout.npz"), f"--out={folder}/again.{kind}", "--worlds", "1", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert (result["frames"], result["worlds"]) == (4, 1)
    assert result["bytes"] == (folder / f"again.{kind}").stat().st_size > 5000
    assert not list(folder.glob(".*")), "nothing half done is left"


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["rollout", "--env.scenario=quda"], "scenario"),
        (["rollout", "--env.n_boxes=50"], "n_boxes"),
        (["rollout", "--env.n_boxs", "3"], "did you mean 'n_boxes'"),
        (["rollout", "--env.n_boxes"], "got no value"),
        (["rollout", "hide_and_sek", "--env.n_boxes", "3"], "did you mean 'hide_and_seek'"),
        (["rollout", "--env.n_boxes", "2", "50", "hide_and_seek", "--worlds=0"], "worlds: got 0"),
        (["rollout", "--worlds=0"], "worlds"),
        (["rollout", "--show=300"], "show: got 300"),
        (["rollout", "--setps=3"], "maax-mjx: unrecognized options: --setps=3; maax-mjx"),
        (
            ["rollout", "tag", "--stepz", "3"],
            "unrecognized options: --stepz, 3; did you mean --steps?; maax-mjx",
        ),
        (["train", "tag", "--mintues", "2"], "--mintues, 2; did you mean --minutes?; maax-mjx train --help lists"),
        (
            ["train", "tag", "--steps", "1e99"],
            "maax-mjx: steps: got '1e99'; takes a whole number of at least 1, or None",
        ),
        (["train", "tag", "--steps=10.5"], "steps: got '10.5'; takes a whole number"),
        (["train", "tag", "--minutes=ten"], "minutes: got 'ten'; takes a positive number, or None"),
        (
            ["train", "tag", "--preset=nope"],
            "invalid choice 'nope' for argument '--preset'. "
            "Expected one of ('baker', 'gpu', 'laptop'); maax-mjx train --help lists what it takes",
        ),
        (
            ["rollout", "tag", "--devices", "7"],
            "maax-mjx: unrecognized or misplaced options: --devices 7; maax-mjx rollout --help lists what it takes",
        ),
        (["rollout", "tag", "--n", "3"], "maax-mjx: unrecognized or misplaced options: --n 3; did you mean"),
        (["evaluate", "tag/trained", "--world", "4"], "unrecognized options: --world, 4; maax-mjx evaluate --help"),
        (["play", "tag", "--stepz", "3"], "unrecognized options: --stepz, 3; maax-mjx play --help"),
        (["--worldz", "4"], "did you mean --worlds"),
        (["rollout", "tag", "--world", "4"], "--world, 4; did you mean --worlds?; maax-mjx rollout --help"),
        (["rollout", "tag", "--worlds"], "missing value for argument '--worlds'. Expected 1 values; maax-mjx rollout"),
        (["evaluate"], "missing from maax-mjx evaluate: POLICY A policy"),
        (["bench", "layouts", "--worlds", "many"], "worlds: got ('many',); takes a list, each a whole number"),
        (["bench", "layouts", "--nope"], "unrecognized options: --nope; maax-mjx bench layouts --help lists"),
        (["worlds", "--n=0"], "n: got 0"),
        (["worlds", "--env.n_boxes=2"], "only rollout"),
        (["replay", __file__], "no saved rollout"),
        (["--tyro-print-completion", "tcsh"], "completion: got 'tcsh'; takes one of ['bash', 'fish', 'zsh']"),
        (["worlds", "--placement", "at:1"], "placement: got 'at:1'; takes at:X:Y"),
        (["worlds", "--placement", "near"], "'separation:RADIUS'"),
        (["train", "runs/nope"], "game: got runs/nope, where no run is; takes a game, my_game.py:football, or a run"),
        (["rollout", "games/football"], "or a game in a file, my_game.py:football"),
        (["replay", "nowhere.npz"], "file: got 'nowhere.npz', which is not there"),
        (["replay", "a.npz", "--out=a.txt"], "out: got a.txt"),
        (["info", "tagg"], "env: got 'tagg'"),
        (["bench", "hide"], "bench: got 'hide'"),
        (["rolout"], "rolout'; did you mean 'rollout'"),
        (["rollout", "--worlds", "1_000_000_000_000"], "worlds: got 1000000000000; takes a whole number of at least 1"),
        (["rollout", "--worlds", "2_000_000_000"], "worlds: got 2,000,000,000; takes fewer than"),
        (["rollout", "--steps=99999999999"], "steps: got 99999999999"),
        (["rollout", "--env.floor_size", "1e9"], "floor_size: got 1000000000.0; takes a positive number of metres"),
        (["rollout", "--env.horizon", "99999999999999"], "horizon: got 99999999999999; takes a whole number"),
        (["rollout", "--env.world_params.timestep", "1e9"], "world_params.timestep: got 1000000000.0; takes"),
        (["rollout", "--env.random_yaw", "maybe"], "random_yaw: got 'maybe'; takes True or False"),
        (["rollout", "--out", ""], "out: got an empty value"),
        (["rollout", "--out="], "out: got an empty value"),
        (["rollout", "--out", __file__], "where no folder can be made"),
        (["rollout", "--seed=-1"], "seed: got -1; takes a whole number in [0, 9223372036854775807]"),
        (["worlds", "--seed", "99999999999999999999999"], "seed: got 99999999999999999999999"),
        (["worlds", "--placement"], "placement: got no value"),
        (["worlds", "--placement=middel:0.5"], "placement: got 'middel'; did you mean 'middle'"),
        (
            ["evaluate", "chase"],
            "policy: got the scripted 'chase'; takes a file, the folder of a run, or a name such as",
        ),
        (["train", "tag", "--devices", "gpu"], "devices: got gpu; takes a number, or all"),
        (["evaluate", "tag/runners", "--episodes=1"], "episodes: got 1; takes a whole number of at least 2"),
        (["worlds", "--scenario"], "scenario: got no value"),
        (["worlds", "--n=1000000000"], "n: got 1000000000"),
        (["worlds", "--n_agents=10000000000"], "n_agents: got 10000000000; takes a whole number"),
        (["worlds", "--out", "folder"], "out: got folder; takes a file that ends in one of .png"),
        (["worlds", "--out", "/"], "out: got /, which is a folder"),
        (["bench", "layouts", "--worlds", "0"], "worlds: got (0,); takes"),
        (["bench", "layouts", "--out", "."], "out: got ., which is a folder"),
        (["info", "quadrant/fort"], "did you mean 'quadrant/forts'"),
        (["evaluate", "quadrant/chase", "--impl=jax", "--env.impl=c"], "impl: got --impl jax and --env.impl c"),
        (["worlds", "--placement=middle:2", "--out=a.png"], "takes middle:FRACTION (fraction: got 2.0; takes"),
        (["evaluate", __file__], "test_cli.py', a Python file; takes a policy, its file"),
        (["info", "laptp"], "did you mean 'laptop'"),
        (["play", "tag", "--policy", "shelter"], "shelter: got a game without ShelterReward"),
        (["replay", __file__], "which is no saved rollout, or damaged (no .npz); takes"),
    ],
)
def test_a_mistake_exits_with_2_and_names_it(argv, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as exited:
        main(argv)
    assert exited.value.code == 2
    told = capsys.readouterr().err
    assert named in told
    assert "compiling" not in told
    assert "Traceback" not in told
    assert "╭" not in told


def test_the_list_of_benchmarks_is_aligned(capsys):
    main(["bench"])
    lines = capsys.readouterr().out.partition("NAME:\n")[2].splitlines()
    assert {line.split()[0] for line in lines} == set(BENCHMARKS)
    assert len({line.index(line.split(maxsplit=1)[1]) for line in lines}) == 1


@pytest.mark.parametrize(
    ("text", "kind", "number"),
    [
        ("1e6", int, 1_000_000), ("1_000", int, 1000), ("12", int, 12), ("1e99", int, "1e99"), ("1.5", int, "1.5"),
        ("nan", int, "nan"), ("inf", int, "inf"), ("1.5", float, 1.5), ("x", float, "x"), ("", float, ""),
        ("99999999999999999999", int, 99999999999999999999),
    ],
)  # fmt: skip
def test_texts_as_numbers(text, kind, number):
    found = number_of(text, kind)
    assert found == number
    assert type(found) is type(number)


@pytest.mark.slow
def test_an_interrupt_writes_what_was_done(tmp_path):
    """It ends the rollout after the step that runs, with everything written; the same again at once changes nothing."""
    process = started_rollout(tmp_path, "4 worlds", "--env.n_boxes=0", "--env.n_ramps=0", "--env.scenario=empty")
    # A longer film only takes longer to draw.
    time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=120)
    assert process.returncode == 130
    result = json.loads(printed)
    assert result["interrupted"]
    assert 0 < result["steps"] < 10000000
    for name in ("worlds.png", "rollout.gif", "world.xml", "rollout.npz"):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.slow
def test_ctrl_c_ends_a_compilation(tmp_path):
    """There is nothing to write yet: the process ends at once, without a traceback, a crash, or folders it made."""
    process = started_rollout(tmp_path / "new" / "files", "compiling")
    time.sleep(1.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    printed, told = process.communicate(timeout=5)
    assert process.returncode == 130
    assert not printed
    assert told.endswith("maax-mjx: interrupted\n")
    assert "Traceback" not in told
    assert not list(tmp_path.iterdir())


def started_rollout(folder, until, *options):
    """A rollout without end in a process of its own, when it has said a word."""
    command = [sys.executable, "-c", "from maax_mjx.cli import main; main()", "rollout", "--worlds=4"]
    options = ["--steps=10000000", "--json", f"--out={folder}", *options]
    process = subprocess.Popen([*command, *options], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    seen = ""
    while until not in seen:
        seen += process.stderr.read(1)
    return process


@pytest.mark.slow
def test_sheet_of_worlds(tmp_path, capsys):
    main(
        [
            "worlds",
            "--scenario",
            "tri",
            "random",
            "--placement=proximity:1.5:box0",
            "--n=5",
            "--n-boxes",
            "2,4",
            f"--out={tmp_path}/a/b.png",
        ]
    )
    assert "5 worlds, 0 invalid" in capsys.readouterr().out
    assert np.asarray(Image.open(tmp_path / "a" / "b.png")).std() > 10


def test_numbers_and_ranges_of_worlds_are_written_as_fields_of_games_are():
    assert apart(("2,6",)) == apart((2, 6)) == (2, 6)
    assert apart((3,)) == (3,)
    assert apart(("2,x",)) == (2, "x")  # for `check_fields` to refuse


@pytest.mark.slow
def test_invalid_layouts_and_the_placement_to_blame(tmp_path, capsys):
    """The centre is free in one of two scenarios, and every world draws one of them."""
    args = ["--scenario", "empty", "half", "--placement=centre", "--n-agents=1", "--n=24", f"--out={tmp_path}/a.png"]
    main(["worlds", "--json", *args])
    told = json.loads(capsys.readouterr().out)
    assert 0 < told["invalid"] < 24
    (blamed,) = told["blamed"]
    assert blamed.startswith(f"centre: {told['invalid'] / 24:.0%} of 24 layouts are invalid")
    assert "agent0 (centre_placement) in 100% of them" in blamed
    with pytest.raises(SystemExit):
        main(["worlds", "--scenario=quad", "--placement=centre", f"--out={tmp_path}/b.png"])
    assert "centre_placement for agent0, which has no place in any world" in capsys.readouterr().err


@pytest.mark.slow
def test_worlds_that_are_all_invalid_are_answered_quickly(tmp_path, capsys, monkeypatch):
    """Both programs, that of the worlds and that which finds what to blame, run once: they are compiled quickly."""
    compiled = []
    for module in ("maax_mjx.cli.worlds", "maax_mjx.core.blame"):
        monkeypatch.setattr(f"{module}.quick_on_cpu", lambda level, module=module: compiled.append((module, level)))
    with pytest.raises(SystemExit):
        main(["worlds", "--scenario=empty", "--placement=separation:7", "--n=2", f"--out={tmp_path}/a.png"])
    assert "none of 202 layouts is valid; no place was found for agent" in capsys.readouterr().err
    assert compiled == [("maax_mjx.cli.worlds", 0), ("maax_mjx.core.blame", 0)]


@pytest.mark.parametrize("text", ["middle:x", "quad:3", "nowhere", "room:x", "proximity:1"])
def test_placements_that_are_none(text):
    with pytest.raises(ValueError, match="placement: got"):
        parse_placement(text)


def test_the_folder_of_a_run_is_no_game(tmp_path, capsys):
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(SystemExit):
        main(["rollout", str(tmp_path)])
    assert f"takes a game: maax-mjx rollout GAME --policy {tmp_path}" in capsys.readouterr().err


def test_version(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"maax-mjx {maax.__version__}\n"


def test_info(capsys):
    main(["info", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["maax_mjx"] == maax.__version__
    assert told["packages"]["mujoco"] == mujoco.__version__
    assert told["auto"] == "c"
    assert told["engines"]["jax"] == "works"
    assert set(told["environments"]) == set(maax.tasks())
    assert told["opengl"]
    main(["info", "hide_and_seek", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["fields"]["lock.radius"] == 0.25
    assert told["fields"]["cone"] is None
    assert "section 5.2.1" in told["about"]
    assert "scenario" not in told["about"], "the parents' text stays out"
    assert "help(maax.WorldConfig)" in told["about"], "but it says where that is"
    assert told["action space"]["move"] == "Box(-1.0, 1.0, (4, 3), float32)"
    assert told["observation space"]["obs"].startswith("Box(-inf, inf, (4, ")
    # Parts of a flat vector are indented.
    whole = {row["name"] for row in told["observations"] if not row["name"].startswith(" ")}
    assert whole == set(told["observation space"])
    main(["info", "hide_and_seek_full", "--env.published", "True", "--env.placement_tries", "3", "--json"])
    fields = json.loads(capsys.readouterr().out)["fields"]
    assert (fields["arms"], fields["lock.soft"], fields["placement_tries"]) == (True, True, 3)
    main(["info", "tag", "--env.observations", "split"])
    printed = capsys.readouterr().out
    assert "Players in a room" in printed
    assert "A room with boxes and ramps" not in printed
    assert "action space" in printed


def test_info_says_what_brings_warp(capsys, monkeypatch):
    monkeypatch.setattr("maax_mjx.physics.select.warp_is_installed", lambda: False)
    main(["info", "--json"])
    told = json.loads(capsys.readouterr().out)["engines"]["warp"]
    assert told == 'not installed: pip install -e ".[cuda]" in a clone of maax_mjx brings it (NVIDIA GPUs)'
    extras = metadata.metadata("maax_mjx").get_all("Provides-Extra")
    assert "cuda" in extras


def test_info_of_a_policy(capsys):
    main(["info", "tag/trained", "--json"])
    told, policy = json.loads(capsys.readouterr().out), training.Policy.load("tag/trained")
    assert (told["game"], told["fields"]["n_frames"]) == ("tag", 10)
    assert told["env steps of its last run"] == f"{policy.steps:,}"
    assert told["networks"]["core"] == policy.network.net.core == "none"
    with pytest.raises(SystemExit):
        main(["info", "tag/trained", "--env.n_frames", "3"])
    assert "for the policy tag/trained; takes them for a game" in capsys.readouterr().err


@pytest.mark.parametrize("name", training.PRESETS)
def test_info_lists_settings_that_options_take(name, capsys):
    main(["info", name, "--json"])
    found = json.loads(capsys.readouterr().out)
    settings = {key: value for key, value in found["settings"].items() if not key.startswith("env.")}
    assert training.preset("baker", settings | {"save_minutes": 7.0}).ppo == training.preset(name).ppo
    assert found["settings"]["env.observe"] == "all"
    for setting in settings:
        assert f" {setting.rpartition('.')[2]}" in found["about"], "it is explained"
    with pytest.raises(SystemExit):
        main(["info", name, "--env.n_boxes", "3"])
    assert f"for the preset {name}; takes them for a game" in capsys.readouterr().err


def test_completions_are_words(capsys):
    """The script offers every line of an option's help that is broken as a word."""
    with pytest.raises(SystemExit):
        main(["--tyro-print-completion", "bash"])
    script = capsys.readouterr().out
    for command in ("rollout", "evaluate", "play", "worlds", "info", "train", "replay"):
        assert command in script
    assert "<or" not in script
    fields = [field for command in COMMANDS.values() for field in dataclasses.fields(command)]
    assert len(fields) > 50
    for command in COMMANDS.values():
        source = inspect.getsource(command).split('"""', 2)[2]
        assert not re.search(r'    """[^"]*\n', source), f"{command.__name__}: a help text of several lines"


@pytest.mark.parametrize("command", ["rollout", "worlds", "replay", "info"])
def test_help_shows_defaults(command, capsys):
    with pytest.raises(SystemExit) as exited:
        main([command, "--help"])
    assert not exited.value.code
    printed = capsys.readouterr().out
    assert "default:" in printed
    assert "--json" in printed


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_tab_completion(shell, capsys):
    with pytest.raises(SystemExit) as exited:
        main(["--tyro-print-completion", shell])
    assert not exited.value.code
    told = capsys.readouterr().out
    for word in ("--steps", "warp", "plan"):
        assert word in told


def test_fields_of_configs():
    argv = ["rollout", "--env.a", "1", "2", "--steps", "3", "--env.b-c=x", "tag", "--env.d", "-1", "--json"]
    assert split_overrides(argv) == (
        ["rollout", "--steps", "3", "tag", "--json"],
        {"a": "1,2", "b_c": "x", "d": "-1"},
    )
    assert split_overrides(["rollout", "--env.a", "1", "2", "tag"]) == (["rollout", "tag"], {"a": "1,2"})
    values = {"2,6": (2, 6), "0.5": 0.5, "None": None, "none": "none", "half,quad": ("half", "quad"), "(1,)": (1,)}
    assert {text: value_of(text) for text in values} == values


@pytest.mark.slow
def test_who_has_read_enough_is_no_mistake():
    """As with `| head -1`: nothing is said, and it is no failure."""
    code = "from maax_mjx.cli import main; import sys; sys.stdin.read(); main(['info', 'tag'])"
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        process.stdin.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0
