"""With two threads on a CPU a large program of jaxlib 0.10 hangs."""

import os
import subprocess
import sys

PROGRAM = """
import jax, jax.numpy as jnp, mujoco
from mujoco import mjx
box = "<body pos='{} 0 .3'><freejoint/><geom type='box' size='.3 .3 .3'/></body>"
boxes = "".join(box.format(i) for i in range(4))
model = mujoco.MjModel.from_xml_string(
    f"<mujoco><worldbody><geom type='plane' size='5 5 1'/>{boxes}</worldbody></mujoco>"
)
m, d = mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")
step = jax.jit(jax.vmap(lambda qpos: mjx.step(m, d.replace(qpos=qpos)).qpos))
qpos = jnp.tile(d.qpos, (64, 1))
for _ in range(20):
    qpos = step(qpos)
qpos.block_until_ready()
"""
SECONDS = 120  # more than four times what it takes with three threads


def ends(threads):
    """Whether 20 steps of 64 worlds end in time."""
    env = os.environ | {"NPROC": str(threads), "JAX_PLATFORMS": "cpu"}
    try:
        subprocess.run([sys.executable, "-c", PROGRAM], env=env, timeout=SECONDS, check=True)
    except subprocess.TimeoutExpired:
        return False
    return True


found = {threads: ends(threads) for threads in (3, 2)}
for threads, ended in found.items():
    print(f"{threads} threads: {'20 steps of 64 worlds' if ended else f'not at the end after {SECONDS} s'}")
assert found[3]
assert not found[2], "it ends now"
