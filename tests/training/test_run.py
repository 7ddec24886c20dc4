"""Runs in folders: what is written, that they go on bit for bit, and that other runs are refused."""

from __future__ import annotations

import functools
import json
import shutil
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers import seeds, toys
from tensorboardX.proto.event_pb2 import Event, SessionLog

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.training.begin import begun_with, check_begun, environment_of, game_fields
from maax_mjx.training.board import Board
from maax_mjx.training.folder import Folder
from maax_mjx.training.network import Network
from maax_mjx.training.run import NotFiniteError, without_the_empty

ROOT = Path(__file__).parents[2]
SMALL = {
    "net.encoder": "flat", "net.core": "gru", "net.hidden": 8, "net.share": "all", "ppo.unroll": 4, "ppo.chunk": 2,
    "ppo.minibatches": 2, "ppo.epochs": 1, "league.every": 2, "visited.share": 0.5, "visited.size": 16,
    "visited.stay": 4,
}  # fmt: skip
PLAIN = SMALL | {"net.core": "none", "ppo.minibatches": 1, "visited.share": 0.0}
"""For the engine that compiles slowly: memories, visited states and minibatches are those of any engine."""
N, FEW = 8, 6
PER_ITERATION = 4 * N

CHILD = """
import os, signal, sys
sys.path.insert(0, "tests")
from helpers import toys
from maax_mjx import training
def stop(now):
    if now.iteration == {half}:
        trainer.save()
    if now.iteration > {half}:
        os.kill(os.getpid(), signal.SIGKILL)
trainer = training.Trainer(toys.echo(), {folder!r}, "laptop", {n}, **{small!r})
trainer.run(on_iteration=stop)
"""


@functools.cache
def echo(impl="c"):
    """One environment for all tests, which is traced once."""
    return toys.echo(impl=impl)


def trainer(folder, impl="c", **changed):
    return training.Trainer(echo(impl), folder, "laptop", N, **(SMALL | changed))


class Luck(maax.ObservationWrapper):
    """Observes what it does not declare."""

    def observation(self, state):
        return state.obs | {"luck": state.reward[:, None]}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of six iterations."""
    folder = tmp_path_factory.mktemp("run") / "echo"
    mine = trainer(folder, tensorboard=True)
    seen = []
    done = mine.run(steps=FEW * PER_ITERATION, on_iteration=lambda now: seen.append(now.iteration))
    assert seen == list(range(1, FEW + 1))
    return mine, done


@pytest.mark.slow
def test_the_folder_has_all_of_it(run):
    _, done = run
    about = json.loads((done.folder / "run.json").read_text())
    assert about["settings"]["worlds"] == N
    assert about["settings"]["ppo"]["unroll"] == 4
    assert about["conditions"]["packages"]["jax"] == jax.__version__
    rows = [json.loads(line) for line in (done.folder / "metrics.jsonl").read_text().splitlines()]
    assert [row["steps"] for row in rows] == [PER_ITERATION * i for i in range(1, FEW + 1)]
    assert {"return_hiders", "kl", "entropy_move", "explained_seekers", "faults"} <= set(rows[-1])
    assert (done.folder / "curves.png").stat().st_size > 5000
    # One before anything was learnt, and one every other iteration.
    assert [int(x.name) for x in sorted((done.folder / "past").iterdir())] == [PER_ITERATION * i for i in (0, 2, 4, 6)]
    assert done.policy.steps == training.Policy.load(done.folder).steps == FEW * PER_ITERATION


def events(folder):
    """Events of TensorFlow's only file of records: a length, a checksum of it, an event, a checksum of that."""
    (file,) = folder.iterdir()
    data = file.read_bytes()
    while data:
        (size,) = struct.unpack("<Q", data[:8])
        yield Event.FromString(data[12 : 12 + size])
        data = data[16 + size :]


def test_tensorboard_forgets_all_that_came_after_the_save(tmp_path):
    """Also what lies between the save and the first new row, whose iteration may have more steps."""
    board = Board(tmp_path)
    board.forget(640)
    board.add({"iteration": 5, "steps": 1920, "kl": 0.1})
    board.close()
    assert [event.step for event in events(tmp_path) if event.session_log.status == SessionLog.START] == [641]


def test_tensorboard_gets_every_number_at_its_step(run):
    found = {
        (value.tag, event.step): value.simple_value
        for event in events(run[1].folder / "tensorboard")
        for value in event.summary.value
    }
    rows = run[0].folder.rows()
    for row in rows:
        assert found["run/kl", row["steps"]] == pytest.approx(row["kl"], rel=1e-5)
        assert found["return/hiders", row["steps"]] == pytest.approx(row["return_hiders"], rel=1e-5)
    assert {step for _, step in found} == {row["steps"] for row in rows}


def test_without_tensorboardx_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(maax.MissingLibraryError, match=r'pip install -e "\.\[tensorboard\]"'):
        trainer(tmp_path / "run", tensorboard=True)


@pytest.mark.slow
def test_a_killed_run_goes_on_bit_for_bit(run, tmp_path):
    """Killed after half of it, saved just before, and gone on in another process."""
    code = CHILD.format(half=FEW // 2, folder=str(tmp_path / "cut"), n=N, small=SMALL)
    killed = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert killed.returncode == -9, killed.stderr
    assert_goes_on(trainer(tmp_path / "cut"), run[0])


@pytest.mark.slow
def test_settings_may_change_and_the_run_tells_which(run, tmp_path):
    copy, was = shutil.copytree(run[1].folder, tmp_path / "run"), run[0].config.ppo.lr
    same, other = {"tensorboard": True}, {"tensorboard": True, "ppo.lr": 0.5, "league.every": 3}
    assert not trainer(copy, **same).changed
    again = trainer(copy, **other)
    assert again.changed == f"ppo.lr=0.5, not {was}; league.every=3, not 2"
    again.save()
    about = again.folder.about()
    assert about["settings"]["ppo"]["lr"] == 0.5
    change = {"iteration": FEW, "steps": FEW * PER_ITERATION, "settings": {"ppo.lr": 0.5, "league.every": 3}}
    assert about["changes"] == [change]
    assert not trainer(copy, **other).changed
    with pytest.warns(UserWarning, match=f"goes on with ppo.lr={was}, not 0.5; league.every=2, not 3"):
        training.train(echo(), copy, "laptop", N, steps=(FEW + 1) * PER_ITERATION, bar=False, **(SMALL | same))
    assert len(again.folder.about()["changes"]) == 2
    # Whose memories would not fit: the worlds begin anew, and what was learnt goes on.
    alone = trainer(copy, **same, **{"league.share": 0.0})
    assert alone.goes_on_in_new_worlds
    assert (alone.iteration, alone.steps) == (FEW + 1, (FEW + 1) * PER_ITERATION)
    # Nothing was saved with that: the whole save still fits what the folder says.
    assert len(alone.folder.about()["changes"]) == 2
    assert not trainer(copy, **same).goes_on_in_new_worlds
    # Nor is there anything else to tell where there is nothing to do.
    other = SMALL | same | {"league.share": 0.0}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        training.train(echo(), copy, "laptop", N, steps=FEW * PER_ITERATION, bar=True, **other)
    ours = [str(warning.message) for warning in told if str(warning.message).startswith("train: ")]
    assert [sentence.rpartition(": ")[2] for sentence in ours] == ["nothing to do"]
    with pytest.raises(
        ValueError, match=r"begin_from \(--from\): got a policy of .* began with none; takes a new folder"
    ):
        trainer(copy, begin_from=again.policy, **same)
    assert not trainer(copy, **same).changed
    with pytest.warns(UserWarning, match=r"goes on with league\.share"), pytest.warns(UserWarning, match="new worlds"):
        training.train(echo(), copy, "laptop", N, steps=(FEW + 2) * PER_ITERATION, bar=False, **other)


@pytest.mark.slow
def test_a_run_whose_updates_are_never_finite_stops_and_keeps_what_was_learnt(tmp_path):
    broken = training.Trainer(toys.unpaid(), tmp_path / "run", "laptop", N, **(SMALL | {"visited.share": 0.0}))
    with pytest.raises(NotFiniteError, match=r"10 iterations in a row .* is finite.*has what was learnt before"):
        broken.run(steps=20 * PER_ITERATION)
    rows = broken.folder.rows()
    assert [row["broken"] for row in rows] == [1.0] * 10
    policy = training.Policy.load(tmp_path / "run")
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(policy.params))
    again = training.Trainer(toys.unpaid(), tmp_path / "run", "laptop", N, **(SMALL | {"visited.share": 0.0}))
    assert again.goes_on_in_new_worlds
    again.run(steps=again.steps + 5 * PER_ITERATION)
    assert len(again.folder.rows()) == 15, "ten in a row are counted anew"


def test_numbers_of_no_episode_are_none():
    counts = {"whole_episodes": 2.0, "ended_a": 4.0, "ended_return_b": 0.0, "reward_a": 0.0}
    found = without_the_empty(counts | {"return_a": 0.0, "return_return_b": 0.0, "episode_caught": 0.5})
    assert [name for name, x in found.items() if np.isnan(x)] == ["return_return_b"]
    found = without_the_empty(counts | {"whole_episodes": 0.0, "episode_caught": 0.0})
    assert np.isnan(found["episode_caught"])


@pytest.mark.slow
def test_a_damaged_save_is_named(run, tmp_path):
    """With what to do about it, whatever of it is missing."""
    copy = shutil.copytree(run[1].folder, tmp_path / "run")
    newest = max(
        (path for path in (copy / "saves").iterdir() if path.name.isdecimal()), key=lambda path: int(path.name)
    )
    for file in newest.iterdir():
        if file.is_file():
            file.unlink()
    for file in newest.rglob("metadata"):
        file.unlink()
    with pytest.raises(ValueError, match=f"folder: the newest save, .*{newest.name}, cannot be read .*; delete it"):
        trainer(copy, tensorboard=True)


def test_a_saved_run_goes_on_bit_for_bit_on_jax(tmp_path):
    """From a copy of what was saved after half of it."""

    def save_half(now):
        if now.iteration == FEW // 2:
            whole.save()
            whole.folder.draw(finished=True)  # no file comes and goes while they are copied
            shutil.copytree(whole.folder.path, tmp_path / "cut")

    whole = trainer(tmp_path / "whole", "jax", **PLAIN)
    whole.run(steps=FEW * PER_ITERATION, on_iteration=save_half)
    assert_goes_on(trainer(tmp_path / "cut", "jax", **PLAIN), whole)


@pytest.mark.parametrize(
    "changed", [{"visited.share": 0.0}, {"visited.size": 32}, {"league.share": 0.5}, {"league.share": 0.0}]
)
def test_a_run_goes_on_in_new_worlds_where_memories_do_not_fit(run, tmp_path, changed):
    """As far as it was, also without the small save; what the save has counts, whatever settings the folder tells."""
    copy = shutil.copytree(run[1].folder, tmp_path / "run")
    shutil.rmtree(copy / "learner")
    about = json.loads((copy / "run.json").read_text())
    for name, value in changed.items():
        group, field = name.split(".")
        about["settings"][group][field] = value
    (copy / "run.json").write_text(json.dumps(about))
    again = trainer(copy, tensorboard=True, **changed)
    assert again.goes_on_in_new_worlds
    assert again.news == ("saves/ has no save of the last policy that fits: what was learnt goes on, in new worlds",)
    assert (again.iteration, again.steps) == (FEW, FEW * PER_ITERATION)
    assert len(again.folder.rows()) == FEW
    for a, b in zip(jax.tree.leaves(run[0].learner), jax.tree.leaves(again.learner), strict=True):
        np.testing.assert_array_equal(a, b)
    # What it saves then is newer than what did not fit.
    again.iteration += 1
    again.save()
    assert not trainer(copy, tensorboard=True, **changed).goes_on_in_new_worlds


def test_a_run_goes_on_in_new_worlds_on_another_engine(run, tmp_path):
    """From `c`, whose states have an array more."""
    copy = shutil.copytree(run[1].folder, tmp_path / "run")
    again = trainer(copy, "jax", tensorboard=True)
    assert again.goes_on_in_new_worlds
    assert again.steps == FEW * PER_ITERATION


def test_past_opponents_play_in_few_worlds(run):
    """There are fewer of them at once, but as many worlds as the share says."""
    opponents = run[0].memory.opponents
    assert run[0].config.league.share * N == jax.tree.leaves(opponents)[0].shape[0] == 2


def assert_goes_on(again, whole):
    """Asserts that a run that was cut after half of it comes to the same as one that was not."""
    assert again.iteration == FEW // 2
    # The same program, which need not be compiled again.
    again._iterate = whole._iterate
    again.run(steps=FEW * PER_ITERATION)
    for name in ("learner", "states", "memory"):
        mine, theirs = getattr(whole, name), getattr(again, name)
        for (path, a), b in zip(jax.tree.leaves_with_path(mine), jax.tree.leaves(theirs), strict=True):
            if not jax.numpy.issubdtype(a.dtype, jax.dtypes.prng_key):
                np.testing.assert_array_equal(a, b, err_msg=f"{name}{jax.tree_util.keystr(path)}")
    rows = again.folder.rows()
    assert [row["iteration"] for row in rows] == list(range(1, FEW + 1))


def test_what_was_learnt_travels_without_its_worlds(run, tmp_path):
    """With another number of worlds, the weights and the optimiser go on, in new worlds."""
    folder = tmp_path / "copy"
    shutil.copytree(run[1].folder, folder)
    shutil.rmtree(folder / "saves")
    assert all(file.stat().st_size < 16e6 for file in (folder / "learner").iterdir())
    again = training.Trainer(echo(), folder, "laptop", 2 * N, **SMALL)
    assert again.goes_on_in_new_worlds
    assert not run[0].goes_on_in_new_worlds
    assert again.steps == FEW * PER_ITERATION
    for a, b in zip(jax.tree.leaves(run[0].learner), jax.tree.leaves(again.learner), strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(again.states.step) == 2 * N


def test_other_runs_are_refused(run, tmp_path):
    folder = run[1].folder
    with pytest.raises(ValueError, match=r"folder: .* has a run with net\.core=gru, not lstm; takes that run's, or"):
        trainer(folder, **{"net.core": "lstm"})
    with pytest.raises(ValueError, match=r"folder: got .* which has a run with seed=0, not 1"):
        training.Trainer(echo(), folder, "laptop", N, seed=1, **SMALL)
    with pytest.raises(ValueError, match=r"folder: got .* which has a run with game=one's own, not tag; takes that"):
        training.Trainer("tag", folder, "laptop", N, **SMALL)
    with pytest.raises(ValueError, match=r"a run with env\.horizon=4, not 6; takes that run's, or another folder"):
        training.Trainer(toys.echo(6), folder, "laptop", N, **SMALL)
    with pytest.raises(ValueError, match=r"a run with no further layer, not Unpaid\(\); takes that run's"):
        training.Trainer(toys.Unpaid(echo()), folder, "laptop", N, **SMALL)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ValueError, match="which has other files; takes an empty one, a new one, or a run's"):
        trainer(tmp_path)
    with pytest.raises(
        ValueError, match=r"worlds: got .* with ppo.minibatches=3, .*the 16 chunks of an iteration do not go"
    ):
        trainer(tmp_path / "a", **{"ppo.minibatches": 3})
    with pytest.raises(
        ValueError, match=r"league\.share: got 0\.05, which of 8 worlds on each device is none; takes 0"
    ):
        trainer(tmp_path / "a", **{"league.share": 0.05})
    with pytest.raises(ValueError, match=r"on_iteration: got 'x'; takes a function of training\.Progress"):
        training.train(echo(), tmp_path / "b", "laptop", on_iteration="x")
    with pytest.raises(ValueError, match="folder: got 5; takes a path"):
        training.train(echo(), 5, "laptop", N, steps=8, **SMALL)
    with pytest.raises(ValueError, match="overrides: got list; takes values by dotted name"):
        training.preset("laptop", ["net.core"])
    with pytest.raises(ValueError, match=r"preset: got 'laptob'.*laptop"):
        training.train(echo(), tmp_path / "b", "laptob", steps=8)
    with pytest.raises(ValueError, match="minutes: got None and no steps; takes one of them"):
        run[0].run()
    with pytest.raises(ValueError, match="minutes: got None and no steps; takes one of them"):
        training.train("tag", tmp_path / "b", "laptop")
    assert not (tmp_path / "b").exists(), "a refusal leaves nothing behind"
    with pytest.raises(
        ValueError, match=r"env: got \['n_boxes'\] with an environment; takes fields only where the game is"
    ):
        training.Trainer(echo(), tmp_path / "c", env={"n_boxes": 2})
    with pytest.raises(ValueError, match=r"env: got 'horizon=3'; takes a dict of the game's fields"):
        training.Trainer("tag", tmp_path / "c", env="horizon=3")
    with pytest.raises(
        ValueError, match=r"folder: got .* which has a run with preset=laptop, not gpu; takes that run's"
    ):
        training.Trainer(echo(), folder, "gpu", N, **{"ppo.minibatches": 1})
    with pytest.raises(ValueError, match="which belongs to no agent; takes an environment whose agents observe"):
        training.Trainer(maax.make("standard", impl="c"), tmp_path / "d", "laptop")
    with pytest.raises(
        ValueError, match=r"train: 'luck' is observed and not declared; say whose it is, in Luck: def decl"
    ):
        training.Trainer(Luck(echo()), tmp_path / "e", "laptop", N, **SMALL)


def test_a_run_without_a_save_is_not_begun_again(run, tmp_path):
    """It would overwrite the policy that is there."""
    copy = tmp_path / "copy"
    shutil.copytree(run[1].folder, copy)
    shutil.rmtree(copy / "saves")
    shutil.rmtree(copy / "learner")
    before = {file: file.read_bytes() for file in copy.rglob("*") if file.is_file() and file.name != ".lock"}
    with pytest.raises(ValueError, match=r"has a policy of \d+ steps and no save to go on from; takes another folder"):
        trainer(copy)
    assert all(file.read_bytes() == was for file, was in before.items())
    assert not (copy / "saves").exists(), "a refusal makes nothing"
    with pytest.raises(ValueError, match=r"path: got '.*past', a folder without a policy; takes a file"):
        training.Policy.load(copy / "past")


def test_renamed_teams_are_another_run(run, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(run[1].folder, copy)
    about = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(about | {"teams": ["cats", "mice"]}))
    with pytest.raises(ValueError, match=r"has a run with teams=\['cats', 'mice'\], not \['hiders', 'seekers'\]"):
        trainer(copy)
    del about["teams"]
    (copy / "run.json").write_text(json.dumps(about))
    assert trainer(copy).steps == FEW * PER_ITERATION, "as runs of before were written"


def test_two_processes_do_not_train_in_one_folder(run, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(run[1].folder, copy)
    hold = "import sys; from maax_mjx.training.folder import Folder; folder = Folder(sys.argv[1]); folder.claim()"
    words = [sys.executable, "-c", f"{hold}; print(1, flush=True); sys.stdin.read()", str(copy)]
    other = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "1\n"
    with pytest.raises(ValueError, match="where another process trains now; takes another folder"):
        trainer(copy)
    other.communicate("")
    assert trainer(copy).steps == FEW * PER_ITERATION


def test_policies_play_wherever_policies_are_taken(run, tmp_path):
    """In a file and out of it; in one piece and in two; alone and in a batch."""
    path = tmp_path / "echo.policy"
    run[1].policy.save(path)
    policy = training.Policy.load(path)
    for a, b in zip(jax.tree.leaves(run[1].policy.params), jax.tree.leaves(policy.params), strict=True):
        np.testing.assert_array_equal(a, b)
    env = echo()
    worlds = maax.Worlds(env, N, donate=False)
    start, key = worlds.reset(jax.random.key(1)), jax.random.key(2)
    _, kept = worlds.rollout(start, policy, 3, key=key, keep=("action",))
    fitted = policy.on(env)
    memory = fitted.memory(N)
    _, by_hand = worlds.rollout(start, fitted.play, 3, fitted.params, key=key, keep=("action",), memory=memory)
    for name in kept["action"]:
        np.testing.assert_array_equal(kept["action"][name], by_hand["action"][name])
    _, recording = maax.record(worlds, start, policy.greedy(), 3, show=[0], every=1)
    assert len(recording.states.step) == 4


def test_a_policy_reads_numbers_in_the_scales_that_it_learnt():
    """In an environment with another range of lidar, whose own networks divide by more."""

    def game(reach):
        return maax.make("hide_and_seek_quadrant", impl="c", observations="split", **{"lidar.range": reach})

    network = Network.of(game(6.0), training.NetConfig())
    policy = training.Policy(network, network.draw(jax.random.key(0)))
    far = game(60.0)
    assert Network.of(far, training.NetConfig()).spec.rays != network.spec.rays
    assert policy.on(far).network.spec == network.spec


def test_a_policy_of_another_game_is_refused_in_a_sentence(run, tmp_path):
    policy = run[1].policy
    with pytest.raises(ValueError, match=r"policy: it reads 8 columns \(x, .*, and env has 10 columns \(ahead"):
        policy.on(maax.make("tag", impl="c", observations="ego"))
    with pytest.raises(
        ValueError, match=r"got one that learnt tag, and env observes or acts otherwise: it reads .* own"
    ):
        training.Policy.load("tag/trained").on(maax.make("tag", impl="c", observations="flat"))
    with pytest.raises(ValueError, match=r"got one that learnt tag, and env plays capture_the_flag: it reads"):
        training.Policy.load("tag/trained").on(maax.make("capture_the_flag", impl="c"))
    with pytest.raises(ValueError, match="make_env: got a policy of an environment of one's own"):
        policy.make_env()
    (tmp_path / "noise").write_bytes(b"noise")
    with pytest.raises(ValueError, match="which is no policy, or damaged"):
        training.Policy.load(tmp_path / "noise")
    with pytest.raises(ValueError, match="which is not there; takes a file"):
        training.Policy.load(tmp_path / "nothing")
    with pytest.raises(ValueError, match="which is not there, and past policies are for evaluate, or files in"):
        training.Policy.load(f"{run[1].folder}@1k")
    with pytest.raises(ValueError, match="path: got None; takes a file"):
        training.Policy.load(None)
    whole = bytearray((run[1].folder / "policy").read_bytes())
    for place in (len(whole) // 3, len(whole) // 2, len(whole) - 40):
        flipped = whole.copy()
        flipped[place] ^= 0xFF
        (tmp_path / "flipped").write_bytes(flipped)
        with pytest.raises(ValueError, match="which is no policy, or damaged"):
            training.Policy.load(tmp_path / "flipped")


@pytest.mark.slow
def test_evaluation_has_intervals_and_finds_the_better_one(run, tmp_path):
    """Those who always say the same are right in half of the episodes, whoever plays the other team."""
    env = echo()
    found = training.evaluate(run[1].policy, ["random", "self", f"{run[1].folder}@0"], episodes=64, env=env)
    assert len(found.matches) == 6
    for match in found.matches:
        assert match.episodes == 64
        assert abs(match.score.mean) <= 1
        assert 0 < match.score.margin < 0.5
    assert set(found.ratings) == {"self", "random", f"{run[1].folder}@0"}
    assert found.ratings["self"].points == 0
    assert "ratings: " in str(found)
    with pytest.raises(ValueError, match=r"against: got 'chaes'.*chase"):
        training.evaluate(run[1].policy, ["chaes"], env=env)
    with pytest.raises(ValueError, match="against: got none; takes at least one opponent"):
        training.evaluate(run[1].policy, [], env=env)
    with pytest.raises(ValueError, match="got 'many' after the @; takes a number of steps, such as 50M"):
        training.evaluate(run[1].policy, [f"{run[1].folder}@many"], env=env)


def test_a_mistyped_setting_is_named_before_what_is_missing(tmp_path):
    with pytest.raises(ValueError, match=r"got 'step'; did you mean 'steps'"):
        training.train("tag", tmp_path, preset="laptop", step=100)


def test_fields_of_the_game_are_settings_as_in_a_shell(tmp_path):
    """Misspelt ones are the game's to refuse, and those of the game without their group are told how they are given."""
    with pytest.raises(ValueError, match=r"make\('tag'\): got 'n_boxs'; did you mean 'n_boxes'"):
        training.train("tag", tmp_path, steps=1, **{"env.n_boxs": 1})
    with pytest.raises(ValueError, match=r"env: got \['n_boxes'\] with an environment"):
        training.train(maax.make("tag", impl="c", n_boxes=0), tmp_path, steps=1, **{"env.n_boxes": 1})
    with pytest.raises(ValueError, match=r"got 'n_boxes'.*; a field of the game is env=\{'n_boxes': \.\.\.\}"):
        training.train("tag", tmp_path, steps=1, n_boxes=1)
    with pytest.raises(
        ValueError, match=r"env: got \['n_boxes'\] as 'env.n_boxes' as well; takes a field of the game once"
    ):
        training.train("tag", tmp_path, steps=1, env={"n_boxes": 1}, **{"env.n_boxes": 2})
    assert environment_of("tag", training.preset("laptop"), game_fields({"env.n_boxes": 0}, None)[1]).base.horizon
    assert game_fields({"env.n_boxes": 0, "ppo.lr": 1}, {"n_ramps": 2}) == ({"ppo.lr": 1}, {"n_ramps": 2, "n_boxes": 0})


def test_a_run_goes_on_with_the_name_of_its_game(run):
    with pytest.raises(ValueError, match="the folder of a run; takes the name of its game, or this alone"):
        training.train(str(run[1].folder), run[1].folder, steps=1)
    with pytest.raises(ValueError, match="a run of an environment of one's own; takes one of a registered game"):
        training.train(run[1].folder, steps=1)
    with pytest.raises(ValueError, match="folder: got none for 'tag'; takes one, or the folder of a run"):
        training.train("tag", steps=1)


def test_a_policy_to_begin_with_is_the_one_that_a_run_began_with(run, tmp_path):
    other = {"game": None, "steps": 7, "transfer": False}
    for was, is_refused in ((None, True), ({"game": None, "steps": 7}, False), (other | {"steps": 8}, True)):
        folder = Folder(tmp_path / str(was))
        folder.describe({"begun_from": was})
        if is_refused:
            with pytest.raises(ValueError, match=r"begin_from \(--from\): got a policy of 7 steps for .* began with"):
                check_begun(folder, other)
        else:
            check_begun(folder, other)
        check_begun(folder, None)
    # Of the same number of steps, as seeds of a sweep are.
    network = run[1].policy.network
    mine, others = (begun_with(training.Policy(network, network.draw(seeds.key(i)), steps=7), False) for i in range(2))
    folder = Folder(tmp_path / "digest")
    folder.describe({"begun_from": mine})
    check_begun(folder, mine)
    training.Policy(network, network.draw(seeds.key(0)), steps=7).save(tmp_path / "mine")
    check_begun(folder, begun_with(training.Policy.load(tmp_path / "mine"), False))
    with pytest.raises(ValueError, match=r"got a policy of 7 steps for .* began with another one, of 7 steps; takes"):
        check_begun(folder, others)
    with pytest.raises(ValueError, match=r"got a policy of 7 steps by transfer for .* began with another one, of 7 st"):
        check_begun(folder, mine | {"transfer": True})
    old = Folder(tmp_path / "old")
    old.describe({"game": None})
    check_begun(old, other)  # runs of before it was noted


def test_a_run_keeps_its_game_when_a_default_changes(tmp_path, monkeypatch):
    folder, made = tmp_path / "run", []
    small = {"ppo.unroll": 4, "ppo.chunk": 4, "ppo.minibatches": 1, "net.width": 16}
    fields = {"n_boxes": 0, "n_ramps": 0, "impl": "c"}
    training.Trainer("tag", folder, "laptop", 8, env=fields, **small)
    about = Folder(folder).about()
    usual = about["game"]["defaults"]["horizon"]
    about["game"]["defaults"]["horizon"] = 33  # as if it had been the default then
    Folder(folder).describe(about)
    with pytest.raises(ValueError, match=rf"has a run with env\.horizon=33, not {usual}; takes that run's"):
        training.Trainer("tag", folder, "laptop", 8, env=fields, **small)
    monkeypatch.setattr(training.Trainer, "run", lambda trainer, *_: made.append(trainer))
    training.train(folder, steps=10**6, bar=False)
    assert made[0].env.base.horizon == 33


def test_a_folder_goes_on_with_its_own_settings(tmp_path, monkeypatch):
    folder, made = tmp_path / "run", []
    begun_with = {"ppo.unroll": 4, "ppo.chunk": 4, "ppo.minibatches": 1, "net.width": 16, "save_minutes": 7.0}
    fields = {"n_boxes": 0, "n_ramps": 0, "impl": "c"}
    training.Trainer("tag", folder, "laptop", 8, seed=3, env=fields, **begun_with)
    monkeypatch.setattr(training.Trainer, "run", lambda trainer, *_: made.append(trainer))
    with pytest.warns(UserWarning, match="goes on with ppo.lr=0.5"):
        training.train(folder, steps=10**6, bar=False, **{"ppo.lr": 0.5})
    (again,) = made
    assert (again.config.worlds, again.config.ppo.lr, again.config.net.width) == (8, 0.5, 16)
    assert (again.config.ppo.unroll, again.config.save_minutes, again.folder.path) == (4, 7.0, folder)
    # By minutes, and on another engine.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        training.train(folder, minutes=1, seed=3, bar=False, **{"env.impl": "jax"})
    assert made[1].env.base.impl == "jax"
    assert again.changed == f"ppo.lr=0.5, not {training.preset('laptop').ppo.lr}"
    new = {"seed": 4, "preset": "gpu", "env": {"n_boxes": 1}, "env.n_boxes": 1, "transfer": True}
    for name, value in (new | {"begin_from": again.policy}).items():
        told = "env.n_boxes" if name == "env" else name
        with pytest.raises(ValueError, match=rf"^{told}: got it with the folder of a run; takes it with a new run"):
            training.train(folder, steps=10**6, **{name: value})
