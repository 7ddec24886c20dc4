"""The benchmark of Warp's kernels: what it counts, on a CPU."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("warp")
from maax_mjx.benchmarks import kernels, launches, plots
from maax_mjx.benchmarks.launches import Launch, Sizes
from maax_mjx.physics.warp_newton import Size, newton_kernels

SIZES = Sizes(
    worlds=4, contacts=40, pairs=10, rows=16, entries=96, used_contacts=6.0, used_rows=5.0, used_entries=24.0,
    iterations=np.array([1, 1, 2, 4]),
)  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "strides", "used"),
    [
        ((4, 3), (12, 4), 12),  # a number of every world
        ((4, 3), (0, 4), 3),  # one that they share
        ((1, 3), (12, 4), 3),
        ((40, 3), (12, 4), 6 * 3),  # of every contact
        ((4, 16), (64, 4), 4 * 5),  # of every row
        ((4, 16, 7), (448, 28, 4), 4 * 5 * 7),  # a dense Jacobian
        ((4, 1, 96), (384, 384, 4), 4 * 24),  # a sparse one
        ((10, 99), (396, 4), 0),  # scratch of convex pairs
    ],
)
def test_elements_in_use(shape, strides, used):
    assert SIZES.elements(shape, strides) == used


def test_traffic_is_of_the_worlds_that_the_solver_still_works_on():
    arrays = [((4, 16, 7), (448, 28, 4), 4), ((4,), (8,), 8)]
    everything = 4 * (4 * 5 * 7) + 8 * 4
    for iteration, share in [(-1, 1), (0, 1), (1, 0.5), (2, 0.25), (3, 0.25), (4, 0)]:
        assert Launch("k", "g", iteration, arrays).traffic(SIZES) == share * everything


def test_kernels_have_groups():
    from mujoco.mjx.third_party.mujoco_warp._src import collision_convex, forward, smooth, solver
    from mujoco.mjx.third_party.mujoco_warp._src.types import GeomType

    assert launches.group_of(smooth._kinematics_branch) == launches.SMOOTH
    assert launches.group_of(solver._zero_change_counters) == launches.SOLVER
    assert launches.group_of(solver._update_gradient_h_incremental) == launches.HESSIAN
    assert launches.group_of(solver._padding_h) == launches.FACTOR
    size = Size(nv=4, rows=8, sparse=False, stride=4, frictions=True, iterations=1, ls_iterations=1, warmstart=True)
    states = ("SATISFIED", "QUADRATIC", "LINEARNEG", "LINEARPOS", "NO_ITERATIONS_LEFT", "NO_LS_ITERATIONS_LEFT")
    for kernel in newton_kernels(size, tuple((name, i) for i, name in enumerate(states))):
        assert launches.group_of(kernel) == launches.ALL
    assert launches.group_of(forward._actuator_force) == launches.MOTION
    pair = collision_convex.ccd_kernel_builder(GeomType.BOX, GeomType.MESH, 12, 12, False, 2, 64, 0)
    assert launches.group_of(pair) == "collision: convex, box and mesh"


@pytest.mark.slow
def test_a_step_is_recorded(run, tmp_path):
    """All launches of the step have a time and a group; it is compiled as ever afterwards."""
    import warp
    from mujoco.mjx.third_party import mujoco_warp

    before = warp.launch, warp.launch_tiled, warp.capture_while, warp.jax_callable, mujoco_warp.step
    options = dict(env=("tiny",), worlds=(4,), played=2, steps=2, recorded=2, copied=1)
    (row,) = run(kernels, tmp_path / "kernels_cpu.json", **options)
    assert (warp.launch, warp.launch_tiled, warp.capture_while, warp.jax_callable, mujoco_warp.step) == before
    assert sum(row["groups_us"].values()) == pytest.approx(row["kernels_us"], abs=1)
    assert row["launches"] > 40
    assert 0 < row["iterations"] <= row["most_iterations"] <= 20
    # The solver of one launch has no loop.
    assert row["loop_us"] == 0
    assert row["groups_us"].keys() == row["traffic_us"].keys() > {launches.ALL, launches.ROWS, launches.SMOOTH}
    assert row["rows"] > 0
    plots.main(plots.Config(tmp_path))
    assert (tmp_path / "kernels_cpu.png").stat().st_size > 10_000
