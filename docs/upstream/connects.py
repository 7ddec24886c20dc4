"""MJX-JAX leaves the velocity terms of connects and welds out."""

import jax
import mujoco
import numpy as np
from mujoco import mjx

XML = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="turner"><joint type="hinge" axis="0 0 1"/><geom size=".1" mass="1" contype="0"/></body>
    <body name="held" pos="1 0 0"><freejoint/><geom size=".1" mass="1" contype="0"/></body>
  </worldbody>
  <equality><connect body1="turner" body2="held" anchor="1 0 0"/></equality>
</mujoco>
"""

model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
data.qvel[:] = [3, 0, 3, 0, 0, 0, 3]  # both turn about the hinge, 3 rad/s, so that the held point does not slip
mujoco.mj_forward(model, data)

m = mjx.put_model(model, impl="jax")
d = jax.jit(mjx.forward)(m, mjx.make_data(m).replace(qvel=jax.numpy.array(data.qvel)))

# The held body has to be drawn to the hinge, by 9 rad²/s² over 1 m.
c, j = data.efc_aref.copy(), np.asarray(d._impl.efc_aref)
print("reference accelerations, C MuJoCo:", c.round(3))
print("reference accelerations, MJX-JAX: ", j.round(3))
print("acceleration of the held body, C MuJoCo:", data.qacc[1:3].round(3))
print("acceleration of the held body, MJX-JAX: ", np.asarray(d.qacc[1:3]).round(3))
assert data.qacc[1] < -8, "C MuJoCo draws it to the hinge"
assert np.abs(c - j).max() > 1, "MJX-JAX has the terms now"
