"""Warp's Newton solver, with its Hessian repaired, against C MuJoCo where stiff rows become inactive."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from maax_mjx.physics.mjx_internals import repair_hessians

BALLS = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <default><geom friction=".001"/></default>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body pos="0 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
    <body pos="1 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
"""Two balls that lie 1 mm deep in a plane."""

BOX = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <default><geom friction=".01"/></default>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body pos="0 0 .05">
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
      <geom type="box" size=".5 .5 .05"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A wide box on a plane, which weighs less than its corners' contacts are stiff."""


def accelerations(xml, up, force, depth=0.001):
    """Accelerations of the first step from rest, by C MuJoCo and by Warp."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    at = data.qpos.astype(np.float32) - depth * up
    data.qpos[:], data.qfrc_applied[:] = at, force
    mujoco.mj_step(model, data)
    m = mjx.put_model(model, impl="warp")
    fresh = mjx.make_data(model, impl="warp", naconmax=16, njmax=32)
    step = jax.jit(jax.vmap(lambda qpos, force: mjx.step(m, fresh.replace(qpos=qpos, qfrc_applied=force))))
    after = step(*(jnp.asarray(x, jnp.float32)[None] for x in (at, force)))
    return data.qacc, np.asarray(after.qacc[0])


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_a_lifted_ball_leaves_the_plane(jacobian):
    repair_hessians()
    ours, warp = accelerations(BALLS.format(jacobian=jacobian), np.array([1, 1]), [20, 0])
    np.testing.assert_allclose(warp, ours, atol=1e-3)


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize(("inertia", "tilt"), [(0.005, 0), (0.02, 6)])
def test_a_lifted_box_does_not_turn_about_the_vertical(jacobian, inertia, tilt):
    repair_hessians()
    up, force = np.array([0, 0, 1, 0, 0, 0, 0]), [0, 0, 20, tilt, 0, 0]
    ours, warp = accelerations(BOX.format(jacobian=jacobian, inertia=inertia), up, force)
    assert np.abs(ours[5]) < 1e-3
    np.testing.assert_allclose(warp, ours, atol=5e-3)
