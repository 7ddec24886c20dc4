"""The benchmarks of what policies know in other tasks, at their smallest."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import seeds

from maax_mjx import training
from maax_mjx.benchmarks import compare, counting, plots, published, scripts, transfer
from maax_mjx.benchmarks import published_oracle as oracle
from maax_mjx.training import config

STEPS = 1000


def pretend(monkeypatch, gain):
    """Training that writes metrics of what it would have learnt: 10 iterations of 100 steps, and one too many."""

    def train(case, config, path):
        path.mkdir(parents=True)
        settings = {"worlds": case.worlds, "ppo": {"gamma": case.gamma, "minibatches": config.minibatches}}
        about = {"conditions": {"devices": ["a GPU"]}, "settings": settings, "preset": config.preset}
        (path / "run.json").write_text(json.dumps(about))
        rows = [
            {
                "iteration": i, "steps": 100 * i, "seconds": 6.0 * i, "episodes": i - 1, "faults": 1,
                "return_hiders": None if i == 1 else gain[case.begin] * i,
            }
            for i in range(1, 12)
        ]  # fmt: skip
        (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))

    monkeypatch.setattr(transfer, "train", train)


def test_runs_are_read_up_to_equal_samples(run, folder, monkeypatch):
    """Returns count by their episodes; a run that has its steps is read and not trained again."""
    pretend(monkeypatch, {transfer.SCRATCH: 1.0, "quadrant/ramps": 2.0})
    options = {"env": ("blueprint",), "seeds": (0, 1), "steps": STEPS, "worlds": 4, "runs": folder / "runs"}
    rows = run(transfer, folder / "transfer_cpu.json", **options)
    assert [(row["begin"], row["seed"]) for row in rows] == [
        (begin, seed) for seed in (0, 1) for begin in (transfer.SCRATCH, "quadrant/ramps")
    ]
    first, second = rows[:2]
    assert first["curve"] == [[100 * i, i] for i in range(2, 11)], "nothing of the iteration after the steps"
    assert first["final"] == 10.0
    assert second["final"] == 20.0
    assert (first["minutes"], first["devices"], first["faults"]) == (1.0, ["a GPU"], 1e4)
    monkeypatch.setattr(transfer, "train", None)
    assert run(transfer, folder / "again_cpu.json", **options)[0]["final"] == first["final"]
    with pytest.raises(TypeError):
        run(transfer, folder / "more_cpu.json", **options | {"steps": 5000})
    for name, value in {"worlds": 8, "gamma": 0.5, "minibatches": 2, "preset": "laptop"}.items():
        with pytest.raises(ValueError, match=f"{name}: got {value}, and .* has a run with"):
            run(transfer, folder / f"{name}_cpu.json", **options | {name: value})
    picture = plots.draw(folder / "transfer_cpu.json", plots.FIGURES["transfer"])
    assert picture.stat().st_size > 10_000


def test_many_points_are_averaged_by_their_episodes():
    points = [(i, 1.0 if i % 2 else 4.0, 2 if i % 2 else 1) for i in range(1, 4 * transfer.POINTS + 1)]
    curve = transfer.curve_of(points)
    assert len(curve) == transfer.POINTS
    assert {y for _, y in curve} == {2.0}


@pytest.mark.parametrize("known", [True, False])
def test_a_classifier_reads_what_memories_know_and_nothing_else(known, run, folder, monkeypatch):
    rng = seeds.rng(0)
    left = rng.binomial(6, 0.5, 2048)
    memories = rng.normal(0, 1, (2048, len(counting.ASKED), 12)).astype(np.float32)
    if known:
        memories[..., :7] += 4 * np.eye(7)[left][:, None]
    monkeypatch.setattr(counting, "watched", lambda case, config: (memories, left))
    (row,) = run(counting, folder / f"counting_{known}.json", begin=("random",), seeds=(0,), worlds=1024)
    assert row["chance"] == pytest.approx(np.bincount(left[1024:]).max() / 1024, abs=1e-4)
    if known:
        assert row["accuracy"] > 0.9
        assert row["off"] < 0.2
    else:
        assert row["accuracy"] < row["chance"] + 0.03
    assert row["accuracy"] == pytest.approx(np.mean(list(row["by_step"].values())), abs=1e-3)


@pytest.mark.slow
def test_memories_are_those_of_frozen_weights(monkeypatch):
    """Random ones differ by seed, and remember what was seen; equal ones watch the same."""
    monkeypatch.setitem(config.PRESETS, "gpu", training.preset("gpu", {"net.hidden": 8, "net.width": 8}))
    options = counting.Config(impl="c")
    first, again, other = (counting.watched(counting.Case(counting.RANDOM, seed, 4), options) for seed in (0, 0, 1))
    assert first[0].shape == (8, len(counting.ASKED), 16)
    np.testing.assert_array_equal(first[0], again[0])
    assert np.abs(first[0] - other[0]).max() > 0.01
    assert ((first[1] >= 0) & (first[1] <= 6)).all()
    assert np.ptp(first[0], axis=0).max() > 1e-3, "worlds are told apart"


def pieces(path, caught, worlds=10):
    """A run of 5 iterations of 100 steps, in each of which 5 episodes end, but for the first."""
    path.mkdir(parents=True)
    about = {"conditions": {"devices": ["a GPU"]}, "settings": {"worlds": worlds}}
    (path / "run.json").write_text(json.dumps(about))
    rows = [
        {"steps": 100 * i, "seconds": 6.0 * i, "episodes": 0 if i == 1 else 5 * i, "episode_caught": x}
        for i, x in enumerate(caught, 1)
    ]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_runs_are_compared_over_the_steps_of_all_their_pieces(run, folder):
    """Beginnings of a piece, whose first episodes are short, are left out; means are of episodes."""
    pieces(folder / "a", [0.9, 0.9, 0.1, 0.2, 0.4])
    pieces(folder / "b", [0.9, 0.9, 0.9, 0.6, 0.6])
    options = {"runs": (f"long={folder / 'a'}+{folder / 'b'}", f"short={folder / 'a'}"), "every": 200}
    options["numbers"] = ("episode_caught",)
    long, short = run(compare, folder / "compare_cpu.json", **options)
    assert (long["steps"], long["minutes"], long["chase"], long["devices"]) == (1000, 1.0, 200, ["a GPU"])
    mean = (0.1 * 15 + 0.2 * 20) / 35
    assert short["curves"]["episode_caught"] == [[400, round(mean, 4)], [500, 0.4]]
    assert long["curves"]["episode_caught"][:2] == [[400, round(mean, 4)], [500, 0.4]]
    assert long["curves"]["episode_caught"][2:] == [[800, 0.9], [1000, 0.6]]
    assert run(compare, folder / "some_cpu.json", **options | {"steps": 400})[0]["steps"] == 400
    for bad in ("nothing", "=a", f"x={folder / 'c'}"):
        with pytest.raises(ValueError, match=r"runs: got .*; takes LABEL=FOLDER"):
            run(compare, folder / "bad_cpu.json", **options | {"runs": (bad,)})
    with pytest.raises(ValueError, match=r"numbers: got 'wrong', which .* lacks"):
        run(compare, folder / "bad_cpu.json", **options | {"numbers": ("wrong",)})
    with pytest.raises(ValueError, match="runs: got none; takes LABEL=FOLDER"):
        run(compare, folder / "bad_cpu.json", **options | {"runs": ()})
    picture = plots.draw(folder / "compare_cpu.json", plots.FIGURES["compare"])
    assert picture.stat().st_size > 10_000


def test_worlds_that_begin_otherwise_are_told_apart(run, folder, monkeypatch):
    """A row for every statistic of the oracle; a few cells further are seen, other numbers of the same kind are not."""
    theirs, ours = (oracle.starts(seeds.rng(i), oracle.QUADRANT, 500) for i in range(2))
    for moved in (0.0, 0.3):
        other = replace(ours, box=ours.box + np.array([moved, 0]))
        samples = oracle.statistics(other), oracle.statistics(theirs)
        monkeypatch.setattr(published, "sampled", lambda *case, samples=samples: samples)
        rows = run(published, folder / f"published_{moved}.json", env=(oracle.QUADRANT,), worlds=500)
        p = {row["statistic"]: row["p"] for row in rows}
        assert len(p) == 22
        changed = {name for name, x in p.items() if x < 1e-4}
        assert changed == ({"box 0, closed: x", "box 1, closed: x"} if moved else set())
    with pytest.raises(ValueError, match="worlds: got 700; takes a multiple of 500"):
        published.Config(worlds=700).check()


def test_what_is_solved():
    """All done in the last step; the end before it; half of the rays stopped."""
    reward = np.array([[0.0, 0.0, 5.0], [1.0, 0.4, 1.0], [1.0, 1.5, 0.98]])
    ended = np.zeros((3, 3), bool)
    assert scripts.solved("lock_and_return", reward, ended).tolist() == [True, False, True]
    assert scripts.solved("lock_all, quad", reward, ended).tolist() == [True, False, True]
    ended[1, 1] = True
    assert scripts.solved("blueprint", reward, ended).tolist() == [False, True, False]
    rays = np.array([[-0.04, -0.04, -0.05], [-0.02, -0.021, -0.0]])
    assert scripts.solved("shelter, twice the time", rays, rays > 0).tolist() == [True, False, True]


@pytest.mark.slow
def test_scripts_are_measured_as_they_play(run, folder, fast_programs):
    """As published, up to the step before the last: here the empty floor, where every script finds its boxes."""
    (row,) = run(scripts, folder / "scripts.json", tasks=("lock_all, empty",), worlds=4, impl="c")
    assert row["solved"][0] >= 0.75
    assert -0.1 < row["first_reward"][0] < 0.5
    assert row["reward"][0] > 0.7
