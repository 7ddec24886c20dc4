"""`mjx.ray` raises a TypeError on a model without a material."""

import jax.numpy as jnp
import mujoco
from mujoco import mjx

BALL = "<mujoco>{}<worldbody><body><freejoint/><geom size='1'{}/></body></worldbody></mujoco>"
MATERIAL = "<asset><material name='red' rgba='1 0 0 1'/></asset>"


def distance(xml):
    """How far a ray gets that starts 3 m from the middle of the ball."""
    model = mujoco.MjModel.from_xml_string(xml)
    m = mjx.put_model(model, impl="jax")
    d = mjx.kinematics(m, mjx.make_data(m))
    return float(mjx.ray(m, d, jnp.array([-3.0, 0, 0]), jnp.array([1.0, 0, 0]))[0])


print("with a material:", distance(BALL.format(MATERIAL, " material='red'")))
try:
    print("without:", distance(BALL.format("", "")))
except TypeError as error:
    print("without: TypeError:", error)
else:
    raise AssertionError("it works without a material now")
