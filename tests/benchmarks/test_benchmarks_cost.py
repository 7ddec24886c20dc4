"""The benchmarks of cost, fidelity and memory at their smallest."""

from __future__ import annotations

import dataclasses
import sys

import pytest

import maax_mjx as maax
from maax_mjx.benchmarks import bench, breakdown, fidelity, first_step, memory, plots
from maax_mjx.benchmarks.traces import Event, attribute, shares_of

HLO = """HloModule jit_roll
%fused (p.0: f32[8]) -> f32[8] {
  %p.0 = f32[8]{0} parameter(0), metadata={op_name="jit(roll)/vmap(Lidar)/LineOfSight/x"}
  %cos.1 = f32[6,4]{1,0} cosine(%p.0), metadata={op_name="jit(roll)/vmap(Lidar)/cos"}
  ROOT %add.2 = f32[8]{0} add(%cos.1, %p.0), metadata={op_name="jit(roll)/vmap(Lidar)/LineOfSight/Base/add"}
}
ENTRY %main (a.1: f32[8]) -> (f32[8], pred[]) {
  %a.1 = f32[8]{0} parameter(0)
  %fusion.1 = f32[8]{0} fusion(%a.1), kind=kLoop, calls=%fused, metadata={op_name="jit(roll)/vmap(Lidar)/LineOfSight"}
  %callback.2 = (f32[8]{0}, /*index=1*/pred[]) custom-call(%a.1), metadata={op_name="Lidar/Base/physics/jit(f)/c"}
  %while.3 = (f32[8]{0}) while(%a.1), body=%fused, metadata={op_name="jit(roll)/while/body/cond/reset/Base/while"}
  ROOT %sort.4 = f32[8]{0} sort(%a.1), metadata={op_name="jit(roll)/while/body/cond/reset/Base/physics/sort"}
}
"""


@pytest.fixture(scope="session")
def run_twice(run):
    """`run_twice(module, path, **options)`: the rows after a run, and after another that adds nothing."""

    def twice(module, path, **options):
        rows = run(module, path, **options)
        before = path.read_text()
        run(module, path, **options)
        assert path.read_text() == before
        return rows

    return twice


@pytest.mark.slow
def test_fidelity(run_twice, folder):
    options = dict(impl=("c",), iterations=(20, 1), worlds=8, steps=40, every=5)
    rows = run_twice(fidelity, folder / "fidelity_c.json", **options)
    full, one = rows
    assert (full["iterations"], one["iterations"], full["singles"]) == (20, 1, 64)
    assert max(full["single_agents_m"] + full["single_objects_m"]) < 1e-6
    assert max(full["free_agents_m"]) < 1e-5
    assert one["single_agents_m"][2] > 100 * full["single_agents_m"][2]
    assert one["free_agents_m"][0] > 1e-4
    assert full["reference_ejected"] == full["faulty_worlds"] == 0


@pytest.mark.slow
def test_breakdown(run_twice, folder):
    (row,) = run_twice(breakdown, folder / "breakdown_c.json", env=("tiny",), worlds=(4,), traced=4, steps=4, horizon=4)
    parts = row["parts_us"]
    assert sum(parts.values()) == pytest.approx(row["traced_us"], rel=0.01)
    assert row["parts_over_traced"] == pytest.approx(1, abs=0.01)
    assert row["busy_over_step"] > 0
    assert min(parts["physics"], parts["layout and reset"]) > 0
    assert parts["vision"] == parts["unnamed"] == 0


@pytest.mark.slow
def test_memory(run_twice, folder, monkeypatch):
    # What is measured is a step's memory, not its doing: another compilation of the physics would tell no more.
    monkeypatch.setattr(maax.Worlds, "step_fn", lambda self, states, action: states.replace(step=states.step + 1))
    (row,) = run_twice(memory, folder / "memory_c.json", env=("tiny",), worlds=(4,))
    assert row["fits"]
    assert row["asked"] == "4"
    assert row["step_bytes"] > 4 * row["state_bytes_per_world"] > 4 * 500
    assert row["pool_peak_bytes"] is None, "a CPU counts nothing"


def test_first_step(run_twice, tmp_path, monkeypatch):
    """The second process finds what the first one left in the cache."""
    stand_in = "import os, pathlib; kept = pathlib.Path(os.environ['JAX_COMPILATION_CACHE_DIR']) / 'kept'; "
    stand_in += "print([1, 2, 3, 0 if kept.exists() else 4]); kept.touch()"
    monkeypatch.setattr(first_step, "PROCESS", stand_in)
    (row,) = run_twice(first_step, tmp_path / "first_step.json", env=("tiny",), impl=("c",), worlds=(4,))
    assert (row["import_s"], row["make_s"], row["reset_s"]) == ([1, 1], [2, 2], [3, 3])
    assert (row["step_s"], row["total_s"]) == ([4, 0], [10, 6])


@pytest.mark.slow
def test_pictures(folder, capsys):
    """Of what the tests above measured."""
    plots.main(plots.Config(folder))
    assert len(capsys.readouterr().out.split()) == len(list(folder.glob("*.json"))) == 3
    assert all(picture.stat().st_size > 10_000 for picture in folder.glob("*.png"))


def test_operations_belong_to_the_innermost_layer_and_fusions_to_several():
    shares = shares_of(HLO, breakdown.part_of)
    assert shares["fusion.1"] == {"lidar": 0.75, "the rest": 0.25}
    assert shares["callback.2"] == {"physics": 1.0}
    assert shares["while.3"] == {}, "its time is that of what it runs"
    assert shares["sort.4"] == {"layout and reset": 1.0}


def test_operations_that_run_together_share_the_time():
    ran = [
        Event("while.3", 0, 100, {}),
        Event("callback.2", 0, 10, {}),
        Event("loop_x", 4, 8, {"hlo_op": "fusion.1"}),
        Event("sort_4", 20, 30, {}),
        Event("sort_4", 25, 25, {}),
        Event("solve_1f_cuda_kernel_forward", 30, 35, {}),
        Event("memset", 35, 40, {}),
        Event("potrf", 40, 42, {"name": "jit(roll)/LockObjects/solve"}),
    ]
    spent, window = attribute(ran, shares_of(HLO, breakdown.part_of), breakdown.part_of, breakdown.PARTS)
    assert {part: time for part, time in spent.items() if time} == {
        "physics": 13,
        "lidar": 1.5,
        "the rest": 0.5,
        "idle": 10,
        "layout and reset": 10,
        "unnamed": 5,
        "locks": 2,
    }
    assert window == sum(spent.values()) == 42
    with pytest.raises(RuntimeError, match="saw no operation"):
        attribute([], {}, breakdown.part_of, breakdown.PARTS)


EMPTY = {field.name: None for field in dataclasses.fields(memory.Row)} | {
    "fits": True,
    "too_large": [],
    "state_bytes_per_world": 0,
}


def test_the_largest_batch():
    """Powers of two below the estimate, until one fits."""

    def row(worlds, **options):
        given = dict(worlds=worlds, fits=True, too_large=[], step_bytes=1000 + 10 * worlds, pool_limit_bytes=21_500)
        return memory.Row(**EMPTY | given | options)

    before = [row(50), row(100), row(200)]
    found = memory.largest(before, 2**20, lambda n: row(n, fits=n < 1000))
    assert (found.estimate, found.worlds, found.too_large, found.asked) == (2050, 512, [2048, 1024], "largest")
    assert memory.largest(before, 256, row).worlds == 256
    # Outside the pool a world takes 20 bytes, and there is room for 12,000: 600 worlds.
    outside = [row(n, outside_pool_bytes=20 * n, device_bytes=33_500) for n in (100, 200)]
    assert memory.estimate(outside) == 600
    with pytest.raises(RuntimeError, match="takes two that fit"):
        memory.largest([row(100)], 256, row)
    with pytest.raises(RuntimeError, match="two batches that grow"):
        memory.largest([row(100), row(200, step_bytes=2000)], 256, row)


def test_a_batch_in_a_process_of_its_own(monkeypatch):
    """It gets the same options, and its row comes back."""
    ran = []

    def run_(command, check, env):
        ran.append(command)
        memory.COMMAND.main(memory.COMMAND.parse(command[3:]))

    monkeypatch.setattr(memory.subprocess, "run", run_)
    monkeypatch.setattr(
        memory, "measure", lambda name, impl, n: memory.Row(**EMPTY | dict(env=name, impl=impl, worlds=n))
    )
    row = memory.measure_alone("tiny", "c", 8)
    assert (row.env, row.impl, row.worlds) == ("tiny", "c", 8)
    assert ran[0][:3] == [sys.executable, "-m", "maax_mjx.benchmarks.memory"]


def test_a_sweep_ends_when_its_time_is_over(tmp_path):
    config = memory.Config(out=tmp_path / "memory.json", max_minutes=1e-9)
    bench.fill(config, [], [memory.Case("tiny", "c", "1")], pytest.fail, str)
    assert not config.out.exists()


def test_errors_before_anything_runs():
    for module, options in [
        (fidelity, dict(steps=0)),
        (breakdown, dict(traced=0)),
        (memory, dict(worlds=(0,))),
        (first_step, dict(worlds=(0,))),
    ]:
        with pytest.raises(ValueError, match=r"got (0|\(0,\)); takes"):
            module.COMMAND.main(module.Config(**options))
