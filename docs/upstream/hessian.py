"""MJX-Warp subtracts stiff rows from its Newton solver's Hessian in float32, and loses the inertia below them."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx
from mujoco.mjx.third_party.mujoco_warp._src import solver

XML = """
<mujoco>
  <default><geom friction=".001"/></default>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body name="lifted" pos="0 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
    <body name="at rest" pos="1 0 .1"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
QPOS, FORCE = [-0.001, -0.001], [20, 0]  # both balls are 1 mm deep in the plane, and one is lifted by 20 N

model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
data.qpos[:], data.qfrc_applied[:] = QPOS, FORCE
mujoco.mj_step(model, data)


def warp_step():
    """The first step from new data, compiled anew."""
    m = mjx.put_model(model, impl="warp")
    fresh = mjx.make_data(model, impl="warp", naconmax=8, njmax=16)
    step = jax.jit(jax.vmap(lambda qpos, force: mjx.step(m, fresh.replace(qpos=qpos, qfrc_applied=force))))
    after = step(jnp.array([QPOS], dtype="float32"), jnp.array([FORCE], dtype="float32"))
    return np.asarray(after.qacc[0]), np.asarray(after._impl.efc__D[0])


kept, stiffness = warp_step()
asked = []


def use_incremental(m):
    """Whether to keep the Hessian: no."""
    asked.append(m)
    return False


solver._use_incremental = use_incremental
anew, _ = warp_step()

# The four rows of a ball's contact all act on its one degree of freedom with a Jacobian of 1.
rows, inertia = np.float32(stiffness[:4].sum()), np.float32(1)
print("one of a contact's four rows, in millions of kg:          ", round(float(stiffness[0]) / 1e6, 1))
print("1 kg in float32 after adding and subtracting four of them:", inertia + rows - rows)
print("accelerations of the balls, C MuJoCo:                     ", data.qacc.round(2))
print("MJX-Warp:                                                 ", kept.round(2))
print("MJX-Warp, Hessian built anew at every iteration:          ", anew.round(2))
assert asked, "MJX-Warp asks no more whether to keep the Hessian"
assert np.isfinite(data.qacc).all()
assert np.abs(anew - data.qacc).max() < 1e-3, "it is the kept Hessian that fails"
assert np.isnan(kept).all(), "MJX-Warp steps it now"
