"""Compiling `mjx.step` for two CPU devices crashes jaxlib 0.11."""

import os
import subprocess
import sys

PROGRAM = """
import sys
import jax, jax.numpy as jnp, mujoco, numpy as np
from jax.sharding import AxisType, PartitionSpec
from mujoco import mjx

jax.config.update("jax_use_shardy_partitioner", sys.argv[1] == "shardy")
body = "<body><freejoint/><geom size='1'/></body>"
model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
m, d = (jax.tree.map(np.asarray, x) for x in (mjx.put_model(model, impl="jax"), mjx.make_data(model, impl="jax")))


def step(qpos):
    on_device, data = jax.tree.map(jnp.asarray, (m, d))
    return mjx.step(on_device, data.replace(qpos=qpos)).qpos


mesh = jax.make_mesh((2,), ("worlds",), axis_types=(AxisType.Auto,))
spec = PartitionSpec("worlds")
steps = jax.jit(jax.shard_map(jax.vmap(step), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))
steps(jnp.tile(d.qpos, (4, 1))).block_until_ready()
"""


def exit_code(partitioner):
    """That of a process which compiles a step for two devices."""
    env = os.environ | {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu", "NPROC": "8",
        "JAX_ENABLE_COMPILATION_CACHE": "0",
    }  # fmt: skip
    command = [sys.executable, "-c", PROGRAM, partitioner]
    return subprocess.run(command, env=env, capture_output=True).returncode


found = {partitioner: exit_code(partitioner) for partitioner in ("gspmd", "shardy")}
for partitioner, code in found.items():
    print(f"partitioner {partitioner}: exit code {code}")
assert found["gspmd"] == 0
assert found["shardy"] == -11, "it compiles now"
