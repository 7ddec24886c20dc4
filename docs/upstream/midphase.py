"""`mujoco.batch.Batch` with geoms of the world body that are moved: the midphase does not see where they are."""

import copy

import mujoco
from mujoco.batch import Batch

WALLS = "".join(f"<geom type='box' size='.1 1 1' pos='{10 + i} 0 1'/>" for i in range(20))
XML = f"""
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>{WALLS}<body><freejoint/><geom size=".2"/><geom size=".2" pos="0 0 .1"/></body></worldbody>
</mujoco>
"""


def moved(model):
    """How far a ball gets in a second that flies at 2 m/s towards a wall, which is put 1 m ahead of it."""
    batch = Batch(model, 1)
    batch.expand("geom_pos")[:, 0] = [1, 0, 0]
    batch.bind("qvel")[:, 0] = 2
    for _ in range(500):
        batch.step()
    return float(batch.bind("qpos")[0, 0])


model = mujoco.MjModel.from_xml_string(XML)
without = copy.copy(model)
without.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
flown, stopped = moved(model), moved(without)
print(f"with the midphase {flown:.2f} m, without it {stopped:.2f} m")
assert stopped < 1, "the wall stops it"
assert flown > 1.5, "it stops it with the midphase now, too"
