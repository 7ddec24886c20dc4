"""What people look at: the command line, its pictures and its file."""

from __future__ import annotations

import signal
import subprocess
import sys

import jax
import mujoco
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from maax_mjx.cli import Rollout, Sheet, main, parse_placement, rollout, sheet
from maax_mjx.export import world_of
from maax_mjx.viewer import contact_sheet, draw_plan


def test_rollout_writes_what_it_says(tmp_path, capsys):
    args = Rollout(worlds=6, steps=20, n_boxes=(1, 2), n_ramps=(0,), out=tmp_path / "out")
    rollout(args)
    printed = capsys.readouterr().out
    for word in ("engine", "worlds", "env-steps/s", "physics steps/s", "agent-steps/s", "compile time",
                 "invalid layouts", "contact overflow"):  # fmt: skip
        assert word in printed
    sheet = np.asarray(Image.open(args.out / "worlds.png"))
    assert sheet.std() > 10
    gif = Image.open(args.out / "rollout.gif")
    assert gif.n_frames == 4
    model = mujoco.MjModel.from_xml_path(str(args.out / "world.xml"))
    assert model.nkey == 1
    assert model.njnt == 4 * 4 + 2 * 4


@pytest.mark.parametrize(
    ("argument", "name"), [("--scenario=quda", "scenario"), ("--n-boxes=50", "n_boxes|boxes"), ("--worlds=0", "worlds")]
)
def test_a_mistake_exits_with_2_and_names_it(argument, name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["maax-mjx", "rollout", argument, f"--out={tmp_path}"])
    with pytest.raises(SystemExit) as exited:
        main()
    assert exited.value.code == 2
    told = capsys.readouterr().err
    assert any(word in told for word in name.split("|"))
    assert "Traceback" not in told


def test_ctrl_c_writes_what_was_done(tmp_path):
    """The first interrupt ends the rollout after the step that runs, with everything written."""
    command = [
        sys.executable,
        "-c",
        "from maax_mjx.cli import main; main()",
        "rollout",
        "--worlds=4",
        "--steps=10000000",
    ]
    process = subprocess.Popen(
        [*command, f"--out={tmp_path}"], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    seen = ""
    while "env-steps/s" not in seen:
        seen += process.stderr.read(1)
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "interrupted: writing what was done" in printed
    for name in ("worlds.png", "rollout.gif", "world.xml"):
        assert (tmp_path / name).stat().st_size > 1000


def test_sheet_of_worlds(tmp_path, capsys):
    sheet(Sheet(scenario=("tri", "random"), placement=("proximity:1.5:box0",), n=5, out=tmp_path / "a" / "sheet.png"))
    assert "5 worlds, 0 invalid" in capsys.readouterr().out
    assert np.asarray(Image.open(tmp_path / "a" / "sheet.png")).std() > 10


@pytest.mark.parametrize("text", ["middle", "quad:3", "nowhere", "room:x", "proximity:1"])
def test_placements_that_are_none(text):
    with pytest.raises(ValueError, match="placement: got"):
        parse_placement(text)


def test_help_explains_every_option(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["maax-mjx", "rollout", "--help"])
    with pytest.raises(SystemExit) as exited:
        main()
    assert not exited.value.code
    printed = capsys.readouterr().out
    for option in ("--worlds", "--steps", "--seed", "--impl", "--scenario", "--n-hiders", "--n-seekers", "--n-boxes",
                   "--n-ramps", "--out"):  # fmt: skip
        assert option in printed


@pytest.fixture(scope="module")
def states(env_ranges, batch_reset):
    return batch_reset(env_ranges, jax.random.split(jax.random.key(0), 8))


def test_plan_draws_everything_where_it_is(env_ranges, states):
    for i in range(8):
        state = world_of(states, i)
        figure = Figure()
        ax = figure.add_subplot()
        draw_plan(ax, env_ranges, state)
        centres = [np.asarray(p.get_center()) for p in ax.patches if hasattr(p, "get_center") and p.zorder >= 3]
        for body in env_ranges.agents.body_ids:
            gap = min(np.linalg.norm(np.asarray(c) - state.data.xpos[body][:2]) for c in centres)
            assert gap < 1e-5
        polygons = [p for p in ax.patches if type(p).__name__ == "Polygon"]
        assert len(polygons) == state.world.active["box"].sum() + state.world.active["ramp"].sum()
        middles = [(p.get_xy().min(axis=0) + p.get_xy().max(axis=0)) / 2 for p in polygons]
        for kind, module in (("box", "boxes"), ("ramp", "ramps")):
            for body, present in zip(env_ranges.modules[module].body_ids, state.world.active[kind], strict=True):
                near = [np.linalg.norm(m - state.data.xpos[body][:2]) < 1e-4 for m in middles]
                assert sum(near) == int(present)
        assert len(ax.lines) == 4 + 2, "a heading for every agent and a line for every door"


def test_team_colours_differ(env_ranges, states, tmp_path):
    colours = [tuple(env_ranges.model.geom_rgba[g]) for g in env_ranges.agents.geom_ids]
    assert colours[0] == colours[1] != colours[2] == colours[3]
    contact_sheet(env_ranges, [world_of(states, i) for i in range(3)], tmp_path / "a.png", ["a", "b", "c"])
    assert Image.open(tmp_path / "a.png").size[0] > 900
