"""MJX-Warp's Newton solver: every iteration is launched for all worlds until the slowest one is done."""

import mujoco
import numpy as np
import warp
from mujoco.mjx.third_party import mujoco_warp

XML = """
<mujoco>
  <option iterations="50" solver="Newton"/>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
    <body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
    <body pos="0 0 .5"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
WORLDS, STEPS = 64, 20

model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)
m = mujoco_warp.put_model(model)
d = mujoco_warp.put_data(model, data, nworld=WORLDS, nconmax=64, njmax=256)
d.qvel.assign(np.random.default_rng(0).normal(0, 1, (WORLDS, model.nv)).astype(np.float32))

launch, tiled, loop = warp.launch, warp.launch_tiled, warp.capture_while
launches, iterations = [], []
inside = 0


def counted(which):
    """The launch function, which counts the launches inside of the solver's loop."""

    def launching(*args, **kwargs):
        launches.append(inside)
        return which(*args, **kwargs)

    return launching


def looped(condition, while_body, **kwargs):
    """Warp's loop, inside of which launches are counted."""
    global inside
    inside = 1
    loop(condition, while_body, **kwargs)
    inside = 0


warp.launch, warp.launch_tiled, warp.capture_while = counted(launch), counted(tiled), looped
for _ in range(STEPS):
    mujoco_warp.step(m, d)
    iterations.append(d.solver_niter.numpy().copy())

iterations = np.array(iterations)
mean, most = iterations.mean(), iterations.max(axis=1).mean()
print("iterations that a world needs, mean:         ", round(float(mean), 1))
print("iterations that are launched for all of them:", round(float(most), 1))
print("kernels of an iteration:                     ", round(sum(launches) / iterations.max(axis=1).sum()))
rows, dofs = float(d.nefc.numpy().mean()), model.nv
print("kB of a world's rows and Hessian:            ", round((rows * dofs + dofs**2) * 4 / 1e3, 1))
assert most > 1.5 * mean, "the slowest world is hardly slower than the others"
assert sum(launches) >= 5 * iterations.max(axis=1).sum(), "an iteration is few kernels now"
