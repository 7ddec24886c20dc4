"""The Newton solver of one launch against C MuJoCo, and that it takes what it can solve and leaves the rest."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx

from maax_mjx.physics import warp_newton
from maax_mjx.physics.mjx_internals import solve_in_one_launch
from maax_mjx.physics.warp_engine import fitted
from maax_mjx.physics.warp_newton import MAX_DOFS, RESERVED, Room, Size

HEAP = """
<mujoco>
  <option jacobian="{jacobian}" iterations="100" ls_iterations="50" cone="{cone}"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="low" pos="0 0 .18"><freejoint/><geom type="box" size=".2 .3 .2" mass="3"/></body>
    <body name="high" pos=".1 0 .56"><freejoint/><geom size=".2" mass="1"/></body>
    <body name="small" pos="-.15 -.25 .47"><freejoint/><geom size=".1" mass=".5"/></body>
    <body pos="1 0 .1">
      <joint name="x" type="slide" axis="1 0 0" frictionloss="2"/><joint type="slide" axis="0 1 0"/>
      <joint name="turn" axis="0 0 1" frictionloss=".1" damping=".1"/>
      <geom size=".1" mass="1"/>
      <body pos="0 0 .3">
        <joint name="elbow" axis="0 1 0" limited="true" range="-.2 .4"/><geom type="capsule" size=".05 .2" mass="1"/>
        <body pos="0 0 .4">
          <joint axis="0 1 0" limited="true" range="-.1 .1"/><geom type="capsule" size=".05 .2" mass=".5"/>
          <body pos="0 0 .4"><joint axis="1 0 0"/><geom type="capsule" size=".05 .2" mass=".2"/></body>
        </body>
      </body>
    </body>
    <body name="held" pos="2 0 1"><freejoint/><geom size=".1" mass="1"/></body>
  </worldbody>
  <equality><connect body1="held" anchor="0 0 .5"/><joint joint1="x" joint2="turn" polycoef="0 .5 0 0 0"/></equality>
</mujoco>
"""
"""Two balls on a box, whose factor has blocks that the Hessian has not, an arm of six joints with limits and friction,
of which two are coupled, and a pendulum: 30 degrees of freedom, the last block of four half empty."""
N_WORLDS = 12


@cache
def heap(jacobian, cone="pyramidal"):
    return mujoco.MjModel.from_xml_string(HEAP.format(jacobian=jacobian, cone=cone))


def random_states(model, rng):
    """Positions and speeds near where the model begins, of which some limits are beyond."""
    start = mujoco.MjData(model)
    mujoco.mj_forward(model, start)
    for _ in range(N_WORLDS):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv) * 0.03, 1.0)
        data.qpos[:] = data.qpos.astype(np.float32)
        data.qvel[:] = rng.normal(size=model.nv).astype(np.float32) * 0.3
        # The last body hangs on a connect, whose rows Warp builds with the speeds of the step before: there was none.
        data.qvel[-6:] = 0
        yield data


def of_warp(model, states):
    """Data of the first step by Warp."""
    m = mjx.put_model(model, impl="warp")
    fresh = mjx.make_data(model, impl="warp", naconmax=32 * N_WORLDS, njmax=160)
    step = jax.jit(jax.vmap(lambda qpos, qvel: mjx.step(m, fresh.replace(qpos=qpos, qvel=qvel))))
    return step(*(jnp.asarray([getattr(d, name) for d in states], jnp.float32) for name in ("qpos", "qvel")))


@pytest.fixture
def asked(monkeypatch):
    """Sizes of the worlds that our kernels were launched for."""
    solve_in_one_launch()
    sizes, launch = [], warp_newton.launch_newton

    def noting(size, *args):
        sizes.append(size)
        launch(size, *args)

    monkeypatch.setattr("maax_mjx.physics.mjx_internals.launch_newton", noting)
    return sizes


def check_against_c(model, states):
    after = of_warp(model, states)
    for world, data in enumerate(states):
        mujoco.mj_step(model, data)
        scale = np.abs(data.qacc).max()
        np.testing.assert_allclose(after.qacc[world], data.qacc, atol=2e-3 * scale)
        np.testing.assert_allclose(after.qfrc_constraint[world], data.qfrc_constraint, atol=2e-2)
    assert np.median([data.nefc for data in states]) > 20


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize("is_left", [False, True])
def test_accelerations_are_those_of_mujoco(jacobian, is_left, asked, monkeypatch):
    """Of rows of every kind, in the first kernel, and in the last one where nothing fits into the first."""
    model, rng = heap(jacobian), seeds.rng(0)
    if is_left:
        room = Size.room
        one = lambda size, is_last: room(size, is_last) if is_last else Room(1, 1, 1, 1, size.n_blocks)  # noqa: E731
        monkeypatch.setattr(Size, "room", one)
        # Blocks that take several worlds, one after the other.
        monkeypatch.setattr(warp_newton, "LAST_BLOCKS", 5)
        warp_newton.newton_kernels.cache_clear()
    check_against_c(model, [*random_states(model, rng)])
    warp_newton.newton_kernels.cache_clear()
    (size,) = set(asked)
    assert size.nv == model.nv > 4
    assert size.sparse == (jacobian == "sparse")


def test_a_world_without_constraints_falls_freely(asked):
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/>"
        "<body pos='0 0 3'><freejoint/><geom type='box' size='.1 .2 .3'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[:] = [0, 0, 0, 1, 2, 3]
    after = of_warp(model, [data])
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(after.qacc[0], data.qacc, atol=1e-4)
    assert not np.asarray(after.qfrc_constraint).any()
    assert asked


STIFF = """
<mujoco>
  <option iterations="100" ls_iterations="50" jacobian="{jacobian}"/>
  <default><geom friction=".001"/></default>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body pos="0 0 .05">
      <freejoint/><inertial pos="0 0 0" mass="1" diaginertia=".005 .005 .005"/><geom type="box" size=".5 .5 .05"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A light box on a plane, whose rows are so stiff that float32 keeps nothing of its inertia beside them."""


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_what_rows_leave_of_a_light_body_is_not_lost(jacobian, asked):
    """Pushed, it slides and turns as in C MuJoCo; without the inertia's own pivots it is no number."""
    model = mujoco.MjModel.from_xml_string(STIFF.format(jacobian=jacobian))
    rng, states = seeds.rng(3), []
    for _ in range(N_WORLDS):
        data = mujoco.MjData(model)
        data.qpos[2] -= 0.001
        data.qpos[:] = data.qpos.astype(np.float32)
        data.qvel[:] = (rng.normal(size=6) * [0.5, 0.5, 0.02, 0.02, 0.02, 1]).astype(np.float32)
        states.append(data)
    after = of_warp(model, states)
    for world, data in enumerate(states):
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(after.qacc[world], data.qacc, atol=5e-2 * np.abs(data.qacc).max())
    assert asked


def test_one_iteration_stops_where_mujoco_does(asked):
    """And not where the solver would go with more."""
    model, rng = heap("dense"), seeds.rng(1)
    states = [*random_states(model, rng)]
    model.opt.iterations = 1
    try:
        stopped = of_warp(model, states)
    finally:
        model.opt.iterations = 100
    far = np.abs(np.asarray(stopped.qacc) - np.asarray(of_warp(model, states).qacc)).max(1)
    assert np.median(far) > 0.1
    assert {size.iterations for size in asked} == {1, 100}


@pytest.mark.parametrize("what", ["elliptic", "many"])
def test_what_it_cannot_solve_goes_to_the_solver_of_mjx(what, asked):
    if what == "elliptic":
        model = heap("dense", cone="elliptic")
    else:
        balls = "".join(f"<body pos='{i} 0 .09'><freejoint/><geom size='.1'/></body>" for i in range(MAX_DOFS // 6 + 1))
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody><geom type='plane' size='1 1 1'/>{balls}</worldbody></mujoco>"
        )
    states = [*random_states(model, seeds.rng(2))]
    after = of_warp(model, states)
    mujoco.mj_step(model, states[0])
    np.testing.assert_allclose(after.qacc[0], states[0].qacc, atol=2e-3 * np.abs(states[0].qacc).max())
    assert not asked


def test_dry_friction_is_left_out_where_no_world_has_it():
    bit = mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    without, with_some = mujoco.MjModel.from_xml_string(STIFF.format(jacobian="dense")), heap("dense")
    assert fitted(without, {}).opt.disableflags & bit
    assert not fitted(without, {"dof_frictionloss": np.arange(1)}).opt.disableflags & bit
    assert not fitted(with_some, {}).opt.disableflags & bit
    assert not without.opt.disableflags & bit, "the model that was given is as it was"
    assert fitted(without, {}).opt.jacobian == mujoco.mjtJacobian.mjJAC_SPARSE
    assert without.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_without_rows_of_dry_friction(jacobian, asked):
    """The code of the solver that has none is another one."""
    model = mujoco.MjModel.from_xml_string(HEAP.format(jacobian=jacobian, cone="pyramidal"))
    model.dof_frictionloss[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    check_against_c(model, [*random_states(model, seeds.rng(4))])
    assert not any(size.frictions for size in asked)


def test_shared_memory_bounds_what_fits():
    size = Size(
        nv=60, rows=672, sparse=True, stride=6564, frictions=False, iterations=20, ls_iterations=20, warmstart=True
    )
    needed = size.room(is_last=True).bytes
    assert size.room(is_last=False).bytes < needed
    assert size.fits(needed + RESERVED)
    assert not size.fits(needed + RESERVED - 1)
    assert not size._replace(sparse=False, rows=2**12).fits(2**30)
    assert not size._replace(nv=MAX_DOFS + 1).fits(2**30)
