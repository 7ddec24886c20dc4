"""`MjSpec.to_xml` prints six digits of a number."""

import mujoco

spec = mujoco.MjSpec()
spec.worldbody.add_geom(name="ball", size=[1 / 3, 0, 0], pos=[10 / 3, 0, 0])
model = spec.compile()
again = mujoco.MjModel.from_xml_string(spec.to_xml())
lost = abs(again.geom("ball").pos[0] - model.geom("ball").pos[0])
print(f"position {float(model.geom('ball').pos[0])} comes back as {float(again.geom('ball').pos[0])}, {lost:.1e} m off")
assert lost > 1e-7, "it comes back exactly now"
