"""Connects between turning bodies against MuJoCo's own reference accelerations."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx

from maax_mjx.physics.connects import with_velocity_terms

XML = """
<mujoco>
  <worldbody>
    <body name="slider" pos="0 0 1">
      <joint type="slide" axis="1 0 0"/><joint type="hinge" axis="0 0 1" pos="0.1 0 0"/>
      <geom size="0.1 0.2 0.1" type="box"/>
      <body name="arm" pos="0.5 0 0"><joint type="hinge" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
    </body>
    <body name="box" pos="1 1 1"><freejoint/><geom size="0.1 0.2 0.3" type="box"/></body>
    <body name="ball" pos="2 1 1"><joint type="ball"/><geom size="0.1" pos="0.3 0 0"/></body>
    <body name="post"><geom size="0.1" pos="0 0 3"/><site name="top" pos="0 0 3"/></body>
  </worldbody>
  <equality>
    <connect body1="arm" body2="box" anchor="0.3 0.1 0"/>
    <connect body1="ball" body2="slider" anchor="0.1 0.2 0.3" active="{active}"/>
    <connect body1="box" anchor="0 0.2 0.1"/>
  </equality>
</mujoco>
"""


@pytest.mark.slow
@pytest.mark.parametrize("active", ["true", "false"])
def test_reference_accelerations_are_those_of_mujoco(active):
    model = mujoco.MjModel.from_xml_string(XML.format(active=active))
    data = mujoco.MjData(model)
    on_device = mjx.put_model(model, impl="jax")

    @jax.jit
    def reference(qpos, qvel):
        d = mjx.make_data(on_device).replace(qpos=qpos, qvel=qvel)
        for stage in (mjx.fwd_position, mjx.fwd_velocity):
            d = stage(on_device, d)
        return d._impl.efc_aref, with_velocity_terms(on_device, d)._impl.efc_aref

    rng, without = seeds.rng(0), []
    for _ in range(5):
        data.qvel[:] = rng.normal(scale=3, size=model.nv)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1)
        mujoco.mj_forward(model, data)
        before, after = (np.asarray(x).reshape(-1, 3) for x in reference(jnp.array(data.qpos), jnp.array(data.qvel)))
        rows = [0, 1, 2] if active == "true" else [0, 2]
        want = data.efc_aref[: 3 * len(rows)].reshape(-1, 3)
        assert np.abs(after[rows] - want).max() < 2e-5 * np.abs(want).max()
        without.append(np.abs(before[rows] - want).max() / np.abs(want).max())
        if active == "false":
            assert (after[1] == before[1]).all()
    assert max(without) > 1e-3, "they must turn for this to mean anything"
