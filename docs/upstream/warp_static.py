"""MJX-Warp computes the poses of geoms on the world body once, in `make_data`."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><geom size='.1'/><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
)
moved = jnp.array(model.geom_pos).at[0].set(jnp.array([5.0, 0, 0]))


def place(impl, **room):
    """Where a step has the geom."""
    m = mjx.put_model(model, impl=impl)
    step = jax.jit(jax.vmap(lambda pos, d: mjx.step(m.replace(geom_pos=pos), d).geom_xpos[0], in_axes=(0, None)))
    return np.asarray(step(moved[None], mjx.make_data(model, impl=impl, **room)))[0]


jax_place, warp_place = place("jax"), place("warp", naconmax=4, njmax=16)
print("a geom of the world body, put at x = 5 m: MJX-JAX has it at", jax_place, "and MJX-Warp at", warp_place)
assert jax_place[0] == 5
assert warp_place[0] == 0, "MJX-Warp moves it now"
