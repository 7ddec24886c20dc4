"""Benchmarks at their smallest: that they run, and what their files hold."""

from __future__ import annotations

import functools
import re
from dataclasses import fields
from importlib import import_module

import jax
import numpy as np
import pytest
from helpers import seeds

import maax_mjx as maax
from maax_mjx.benchmarks import BENCHMARKS, grabs, gradients, hostile, layouts, load, outer, plots, sampling, step

ALONE = {"n_hiders": 1, "n_seekers": 0, "n_boxes": 0, "n_ramps": 0}


@pytest.fixture(scope="module")
def sampled(run, folder):
    path = folder / "sampling_cpu.json"
    return run(sampling, path, edges=(2.0,), densities=(0.9,), full_edge=2.0, worlds=(3,), rounds=2)


@pytest.fixture(scope="module")
def loaded(run, folder):
    return run(load, folder / "load_c_cpu.json", edges=(), boxes=(1,), dense_edges=(), rounds=1)


def test_sampling(sampled):
    ways = [("poisson", 1), ("darts", 1), ("field", 3)]
    assert [(row["method"], row["worlds"]) for row in sampled] == 2 * ways
    assert [row["sweep"] for row in sampled] == ["edge"] * 3 + ["density"] * 3
    for row in sampled:
        assert row["wanted"] == 14
        assert row["closest_m"] >= 0.5
        assert row["ms_per_world"] > 0
        n_worlds = 2 * row["worlds"]
        assert row["failures"] == pytest.approx(n_worlds * (row["wanted"] - row["found"]), abs=0.02 * n_worlds)
        assert row["found"] > 11, "14 points of 0.25 m fill the floor nearly, for every method"


@pytest.mark.parametrize("compiled", [step.compiled, hostile.compiled])
def test_games_are_made_with_what_is_asked_for_alone(compiled, monkeypatch):
    """A game of one's own need not have room for contacts, or bodies, among its fields."""
    given = []

    def make(name, **fields):
        given.append(fields)
        raise InterruptedError

    monkeypatch.setattr(maax, "make", make)
    arguments = ("king", "c", 2, 8, 4, None, "ours") if compiled is step.compiled else ("king", "c", 2, None, None)
    with pytest.raises(InterruptedError):
        compiled(*arguments)
    assert set(given[0]) - {"horizon"} == {"impl"}


def test_scattered_points_keep_apart_inside():
    draw = jax.jit(jax.vmap(lambda key: sampling.scatter(14, 0.5, 2.0, 0.2, key)))
    for table in np.asarray(draw(jax.random.split(seeds.key(0), 8))):
        points = table[table[:, 2] > 0, :2]
        assert sampling.closest(points) >= 0.5
        assert ((points >= 0) & (points <= 2)).all()


def test_darts_keep_apart_inside_and_give_up():
    assert len(sampling.throw_darts(5, 0.5, 4.0, 0, 30)) == 5
    points = sampling.throw_darts(500, 0.5, 4.0, 0, 30)
    # Discs of half the radius, packed like honeycomb: no more than 93 have their middles on the floor.
    assert len(points) < 94
    assert sampling.closest(points) >= 0.5
    assert ((points >= 0) & (points <= 4)).all()


def test_load(loaded):
    (row,) = loaded
    assert (row["sweep"], row["edge_m"], row["grid_size"], row["n_boxes"]) == ("objects", 6.0, 30, 1)
    parts = [row[name] for name in ("spec_s", "model_s", "engine_s", "reset_s", "step_s")]
    assert min(parts) > 0
    assert row["total_s"] == pytest.approx(sum(parts), abs=1e-4)
    assert row["next_reset_s"] < row["total_s"]


def test_worlds_to_load():
    config = load.Config(edges=(6.0, 12.0), boxes=(0, 20), dense_edges=(8.0,))
    assert [(case.sweep, case.edge_m, case.n_boxes) for case in load.cases(config)] == [
        ("floor", 6.0, 1),
        ("floor", 12.0, 1),
        ("objects", 6.0, 0),
        ("objects", 6.0, 20),
        ("dense", 8.0, 16),
    ]


@pytest.mark.slow
def test_layouts(run, tmp_path):
    (row,) = run(layouts, tmp_path / "layouts_c.json", worlds=(4,), rounds=2, steps=2, bare=True)
    assert (row["impl"], row["scene"], row["worlds"], row["layouts_invalid"]) == ("c", "M", 4, 0)
    assert row["ratio"] == pytest.approx(row["reset_ms"] / row["step_ms"], rel=0.05)
    assert row["bare_ratio"] > 0


@pytest.mark.slow
def test_step(run, tmp_path):
    """A row for each case, in the order of the cases."""
    rows = run(step, tmp_path / "step_c.json", env=("tiny",), impl=("c",), worlds=(2,), steps=16, held=(1, 20))
    kinds = [(held, episodes) for held in (1, 20) for episodes in ("lockstep", "staggered")]
    assert [(row["held"], row["episodes"]) for row in rows] == kinds
    for row in rows:
        assert (row["steps"], row["horizon"], row["n_frames"]) == (16, 6, 1)
        # 16 steps hold two whole episodes of six; staggered, a world may have ended a third.
        most = 4 if row["episodes"] == "lockstep" else 6
        assert 4 <= row["episodes_ended"] <= most
        assert row["ratio"] == pytest.approx(row["env_steps_per_s"] / row["bare_steps_per_s"], rel=0.02)


@pytest.mark.slow
def test_hostile(run, tmp_path):
    rows = run(hostile, tmp_path / "hostile_c.json", games=("tiny_bins",), worlds=2, steps=100, held=(50, 1))
    assert [(row["force"], row["held"]) for row in rows] == [("random", 1), ("full", 50), ("full", 1)]
    for row in rows:
        assert all(row[name] for name in ("finite", "inside", "faults_truncate"))
        assert (row["physics_steps"], row["physics_faults"]) == (2 * 100 * 3, 0)
        assert row["env_steps_per_s"] > 0


@pytest.mark.slow
def test_hostile_counts_faults_until_time_is_over(run, tmp_path):
    """Every world of this game has a fault in every step."""
    options = dict(games=("tiny_faulty",), worlds=2, steps=10**7, held=(), max_minutes=0.02)
    row, *_ = run(hostile, tmp_path / "hostile_faulty.json", **options)
    assert 100 <= row["physics_faults"] == row["physics_steps"] < 10**6
    assert row["faults_per_million"] == 1e6
    assert row["finite"]
    assert row["faults_truncate"]


@pytest.mark.parametrize("game", ["tiny", "tiny_bins"])
def test_hostile_forces(game):
    """Full ones are the greatest either way, as often; random ones are the space's own."""
    env = maax.make(game, impl="c")
    full, random = (np.asarray(hostile.actions(env, 500, seeds.key(0), kind)["move"]) for kind in (True, False))
    low, high = (-1, 1) if game == "tiny" else (0, 10)
    assert set(np.unique(full)) == {low, high}
    # 1,500 throws of a coin: six standard deviations.
    assert abs((full == high).mean() - 0.5) < 6 * 0.5 / 1500**0.5
    assert len(np.unique(random)) > 2
    assert random.dtype == full.dtype


@pytest.mark.slow
def test_outer(run, tmp_path, monkeypatch):
    """What is timed together is compared with itself; one agent within every boundary compiles fast."""
    monkeypatch.setattr(outer.maax, "make", functools.partial(maax.make, scenario="empty", **ALONE))
    rows = run(outer, tmp_path / "outer_c.json", worlds=2, steps=8, held=(1,))
    assert [row["outer"] for row in rows] == list(outer.OUTER)
    walls = rows[0]["env_steps_per_s"]
    for row in rows:
        # Steps per second are whole numbers, and few on a machine that is busy.
        assert row["ratio"] == pytest.approx(row["env_steps_per_s"] / walls, rel=1 / walls, abs=0.02)


def test_grabs(run, tmp_path):
    rows = run(grabs, tmp_path / "grabs_cpu.json", steps=400, stiffness=(2000.0, 20_000.0), frames=(1,))
    assert [row["rows_per_pair"] for row in rows] == [4, 6, 6, 0, 0]
    assert [row["stable"] for row in rows] == [True] * 4 + [False]
    assert [row["steps"] == 400 for row in rows] == [True] * 4 + [False]
    shipped, weld, soft, spring, _ = (row["median_mm"] for row in rows)
    assert max(shipped, weld) < 15 < min(soft, spring)


@pytest.mark.usefixtures("sampled", "loaded")
def test_plots_redraw_what_the_benchmarks_drew(folder, capsys):
    pictures = [folder / "load_c_cpu.png", folder / "sampling_cpu.png"]
    for picture in pictures:
        assert picture.read_bytes().startswith(b"\x89PNG")
        picture.unlink()
    (folder / "step_cpu.json").write_text("{}")
    plots.main(plots.Config(folder))
    assert capsys.readouterr().out.split() == [str(p) for p in pictures]
    assert all(p.stat().st_size > 10_000 for p in pictures)
    assert not (folder / "step_cpu.png").exists()


@pytest.mark.parametrize(
    ("module", "options", "message"),
    [
        (sampling, dict(radius=0.0), "radius: got 0.0; takes a positive number"),
        (sampling, dict(densities=(0.3, -1.0)), "densities: got -1.0"),
        (sampling, dict(rounds=0), "rounds: got 0"),
        (load, dict(edges=(6.1,)), "edges: got 6.1; takes multiples of 0.2"),
        (load, dict(rounds=0), "rounds: got 0"),
        (grabs, dict(damping=0.0), "damping: got 0.0"),
        (grabs, dict(frames=(1, 0)), "frames: got (1, 0)"),
        (layouts, dict(scenes=("N",)), "scenes: got 'N'; takes one of"),
        (layouts, dict(worlds=(0,)), "worlds: got (0,); takes a list, each a whole number of at least 1"),
        (layouts, dict(steps=0), "steps: got 0"),
        (step, dict(worlds=(8, 0)), "worlds: got (8, 0)"),
        (hostile, dict(steps=30), "steps: got 30; takes a multiple of 50"),
        (hostile, dict(games=("tag", "tagg")), "games: got 'tagg'; did you mean 'tag'? It takes one of"),
        (hostile, dict(held=(20, 0)), "held: got (20, 0)"),
        (outer, dict(steps=7), "steps: got 7"),
        (gradients, dict(repeats=0), "repeats: got 0"),
        (gradients, dict(max_minutes=0.0), "max_minutes: got 0.0"),
    ],
)
def test_errors_before_anything_runs(module, options, message, tmp_path):
    with pytest.raises(ValueError, match=re.escape(message)):
        module.COMMAND.main(module.Config(out=tmp_path / "out.json", **options))
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize("name", [name for name in BENCHMARKS if name != "plots"])
def test_no_number_of_any_benchmark_may_be_negative(name):
    config = import_module(f"maax_mjx.benchmarks.{name}").COMMAND.config
    numbers = [f for f in fields(config) if type(f.default) is int]
    lists = [f for f in fields(config) if isinstance(f.default, tuple) and f.default and type(f.default[0]) is int]
    for f in (*numbers, *lists):
        with pytest.raises(ValueError, match=f"{f.name}: got .*takes"):
            config(**{f.name: (-1,) if f in lists else -1}).check()
    assert numbers or lists


def test_files_that_are_no_records(tmp_path):
    path = tmp_path / "sampling_x.json"
    for text, message in [
        ("{", "takes a benchmark's JSON record"),
        ('{"rows": []}', "takes a benchmark's JSON record"),
    ]:
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            plots.draw(path, plots.FIGURES["sampling"])
    with pytest.raises(ValueError, match="folder: got"):
        plots.main(plots.Config(tmp_path / "nowhere"))
