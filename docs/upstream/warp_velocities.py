"""MJX-Warp makes constraints with the velocities of bodies that the step before left in the data."""

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
data.qvel[:] = [3, 0, 3, 0, 0, 0, 3]
mujoco.mj_forward(model, data)

m = mjx.put_model(model, impl="warp")
forward = jax.jit(jax.vmap(lambda qvel, d: mjx.forward(m, d.replace(qvel=qvel)), in_axes=(0, None)))
fresh = mjx.make_data(model, impl="warp", naconmax=8, njmax=8)
qvel = jax.numpy.array(data.qvel, dtype="float32")[None]
first = np.asarray(forward(qvel, fresh).qacc[0])
with_velocities = fresh.replace(cvel=jax.numpy.array(data.cvel), cdof_dot=jax.numpy.array(data.cdof_dot))
second = np.asarray(forward(qvel, with_velocities).qacc[0])
print("acceleration of the held body, C MuJoCo:                  ", data.qacc[1:3].round(3))
print("MJX-Warp, new data with qpos and qvel:                    ", first[1:3].round(3))
print("MJX-Warp, new data with qpos, qvel, cvel and cdof_dot:    ", second[1:3].round(3))
assert np.abs(second - data.qacc).max() < 1e-2, "these are the velocities that it reads"
assert np.abs(first - data.qacc).max() > 1, "it computes velocities first now"
