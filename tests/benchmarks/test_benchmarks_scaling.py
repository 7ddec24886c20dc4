"""The thesis's evaluation at its smallest: what is measured, resumed and drawn."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from functools import cache, partial

import jax
import mujoco
import numpy as np
import pytest

import maax_mjx as maax
from maax_mjx.benchmarks import bench, engines, objects, plots, record, rollouts, scaling
from maax_mjx.benchmarks.ant import ant

TINY = dict(steps=8, rollouts=2)


@pytest.fixture(scope="session")
def run_tiny(run):
    """`run` with short rollouts."""
    return partial(run, **TINY)


def test_the_ant_lands_on_its_feet():
    model = ant()
    assert (model.nq, model.nv, model.nu) == (15, 14, 8)
    assert model.opt.timestep == maax.WorldParams().timestep
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 800)
    touching = {model.geom(geom).name for geom in data.contact.geom.flat}
    assert touching == {"floor", *(f"leg{i}:foot" for i in range(4))}
    assert np.abs(data.qvel).max() < 0.1
    # Symmetric: it stays where it was dropped, upright, above the height of its torso's sphere.
    np.testing.assert_allclose(data.qpos[[0, 1, 4, 5, 6]], 0, atol=1e-6)
    assert data.qpos[2] > 0.3


def test_ants_follow_plain_mujoco():
    """The batch that is timed moves as one `MjData` does, stepped by hand under the same forces."""
    model = ant()
    batch = rollouts.of_model(model, "c", 3, 25)
    forces = batch.draw(1)
    state = batch.roll(batch.begin(), forces, np.arange(20), 1)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for i in range(20):
        data.ctrl[:] = forces["forces"][i % 16, 2]
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(batch.positions(state)[2], data.qpos, atol=1e-9)


def test_scaling_is_resumed(run_tiny, folder, capsys, monkeypatch):
    # A world that compiles fast.
    config = maax.StandardConfig(scenario="empty", n_hiders=1, n_seekers=0, n_boxes=0, n_ramps=0, impl="c")
    monkeypatch.setattr(scaling, "_worlds", cache(lambda *case: maax.Worlds(maax.make("standard", config), case[2])))
    path = folder / "scaling_c.json"
    options = dict(scenes=("M", "Ant"), worlds=(2,), large=1, large_steps=4)
    rows = run_tiny(scaling, path, **options)
    assert [(row["scene"], row["what"]) for row in rows] == [("M", "env"), ("M", "bare"), ("Ant", "bare")]
    for row in rows:
        assert (row["steps"], row["rollouts"], row["nan_worlds"]) == (4, 2, 0)
        # The mean of rates is no less than the rate of the mean, and equal to it where rollouts are.
        assert row["steps_per_s"] >= 0.99 * 2 * 4 / row["seconds"]
    assert rows[0]["faults"] == 0

    measured = []
    monkeypatch.setattr(rollouts, "measure", lambda *args: measured.append(args) or rollouts.Figures(1, 0, note="-"))
    assert run_tiny(scaling, path, **options) == rows
    assert not measured
    assert len(run_tiny(scaling, path, **options | dict(scenes=("Ant", "M"), worlds=(2, 1), what=("bare",)))) == 5
    assert len(measured) == 2
    assert "M " not in capsys.readouterr().out.split("note")[2]


def test_engines(run_tiny, folder):
    path = folder / "engines_c.json"
    (row,) = run_tiny(engines, path, engines=("c",), worlds=(2,), iterations=(20,), held=(1,))
    assert (row["nan_worlds"], row["faults"]) == (0, 0)
    _, _, xml = engines.exported()
    plain = mujoco.MjModel.from_xml_string(xml)
    away = np.stack([plain.key_qpos[0]] * 4)
    away[0, 0] = -1.0  # agent0, a metre outside
    away[1, 2] = 3.5  # agent0, above the ceiling
    away[2] = np.nan
    assert engines.count_faults(away) == 3


def test_brax_gets_the_same_world():
    _, _, xml = engines.exported()
    plain, chained = (mujoco.MjModel.from_xml_string(text) for text in (xml, engines.for_brax(xml)))
    assert (chained.nv, chained.nu) == (plain.nv, plain.nu)
    assert not chained.qpos0.any()
    poses = []
    for model in (plain, chained):
        data = mujoco.MjData(model)
        data.qpos[:] = plain.key_qpos[0] + np.linspace(0, 0.5, plain.nq)
        mujoco.mj_kinematics(model, data)
        poses.append({model.geom(i).name: (data.geom_xpos[i], data.geom_xmat[i]) for i in range(model.ngeom)})
    for name, pose in poses[0].items():
        np.testing.assert_allclose(np.concatenate(pose), np.concatenate(poses[1][name]), atol=1e-9)
    assert ET.fromstring(engines.for_brax(xml)).find("worldbody/body/body/joint").get("name") == "agent0:yaw"


def test_missing_engines_are_said_and_tried_again(run_tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    for _ in range(2):
        (row,) = run_tiny(engines, tmp_path / "e.json", engines=("brax",), worlds=(2,), iterations=(5,), held=(1,))
        assert (row["note"], row["seconds"]) == ("not installed", None)


def test_objects():
    config = objects.Config(counts=(0, 9), edges=(4.0, 12.0))
    cases = list(objects.cases(config))
    assert len(cases) == len(set(cases)) == 2 * 2 * 2 * 2 + 2
    assert (cases[-1].n_boxes, cases[-1].n_ramps) == (36, 1)
    free = next(c for c in cases if (c.sweep, c.n_boxes, c.joints, c.outer) == ("boxes", 9, "free", "none"))
    model = objects.world(free).model
    assert (model.nv, sum("wall" in model.geom(i).name for i in range(model.ngeom))) == (4 * 4 + 9 * 6, 4)


def test_objects_rows(run_tiny, folder, monkeypatch):
    figures = rollouts.Figures(8, 2, 0.1, 0.0, 160, 1.0, 0, 0, 0)
    monkeypatch.setattr(rollouts, "measure", lambda *args: figures)
    rows = run_tiny(objects, folder / "objects_c.json", counts=(1, 0), worlds=2, edges=(6.0,), joints=("slides",))
    assert len(rows) == 2 * 2 * 2 + 1
    assert all(row["build_s"] > 0 for row in rows)


def test_out_of_memory_is_a_row():
    def fails(text):
        raise jax.errors.JaxRuntimeError(text)

    protocol = rollouts.Protocol()
    figures = rollouts.measure(partial(fails, "RESOURCE_EXHAUSTED: Out of memory while trying to"), 8192, protocol)
    assert figures == rollouts.Figures(steps=100, rollouts=0, note="out of memory")
    with pytest.raises(jax.errors.JaxRuntimeError, match="INTERNAL"):
        rollouts.measure(partial(fails, "INTERNAL: something else"), 2, protocol)


@dataclasses.dataclass(frozen=True)
class Plain(engines.Case, record.Measured):
    """A row that is nothing but its case."""


def test_budget_and_files_of_others(tmp_path, capsys):
    cases = [engines.Case("c", n, 20, 1) for n in (1, 2, 3)]
    rows = [Plain(**vars(cases[1]))]
    assert list(bench.remaining(cases, rows, 1e-9)) == []
    assert "2 rows to go" in capsys.readouterr().out
    assert list(bench.remaining(cases, rows, None)) == [cases[0], cases[2]]
    path = tmp_path / "x.json"
    record.write(path, rows)
    assert record.resume(path, Plain) == rows
    with pytest.raises(ValueError, match="takes a file with rows of this benchmark"):
        record.resume(path, scaling.Row)
    path.write_text(path.read_text().replace('"cpus": ', '"cpus": 9'))
    with pytest.raises(ValueError, match="takes a new file"):
        record.resume(path, Plain)


@pytest.mark.parametrize(
    ("module", "options", "message"),
    [
        (scaling, dict(scenes=("N",)), "scenes: got 'N'"),
        (scaling, dict(rollouts=0), "rollouts: got 0"),
        (engines, dict(engines=("bullet",)), "engines: got 'bullet'"),
        (objects, dict(joints=("ball",)), "joints: got 'ball'"),
        (objects, dict(edges=(6.1,)), "edges: got 6.1"),
    ],
)
def test_errors_before_anything_runs(module, options, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        module.COMMAND.main(module.Config(out=tmp_path / "out.json", **options))


def test_pictures(folder):
    """Of the files that the tests above left, a row without figures among them."""
    drawn = [plots.draw(path, plots.FIGURES[path.stem.split("_")[0]]) for path in sorted(folder.glob("*.json"))]
    assert [path.stem for path in drawn] == ["engines_c", "objects_c", "scaling_c"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in drawn)
