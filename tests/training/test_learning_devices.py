"""Training on several devices and in several processes is training on one device."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers import toys

from maax_mjx import training

ROOT = Path(__file__).parents[2]
SMALL = {"net.encoder": "flat", "net.core": "none", "net.hidden": 8, "net.share": "all", "ppo.unroll": 4}
SMALL |= {"ppo.chunk": 2, "ppo.epochs": 1, "ppo.minibatches": 2}
# Past opponents play in the last worlds of every device, which are others on two than on one.
SMALL |= {"league.share": 0.0}
WORLDS, STEPS = 8, 3 * 32
CODE = f"""
import sys
sys.path.insert(0, "tests")
import jax
count, process, port, folder = *map(int, sys.argv[1:4]), sys.argv[4]
if count > 1:
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.distributed.initialize(f"localhost:{{port}}", count, process)
from helpers import toys
from maax_mjx import training

# The first process alone asks for the end, after three iterations; all have to hear of it.
stop = lambda now: process != 0 or now.steps < {STEPS}
env = toys.echo()
keep = folder + " faults" if count == 1 else None
one = training.Trainer(env, folder, "laptop", {WORLDS}, keep_faults=keep, **{SMALL})
done = one.run(steps=None if count > 1 else {STEPS}, on_iteration=stop)
assert keep is None or one.worlds.faults() == []
assert len(jax.devices()) == 2 and done.policy.steps == {STEPS}
if count > 1:
    again = training.Trainer(env, folder, "laptop", {WORLDS}, **{SMALL})
    assert again.iteration == 3
"""
TIMES = {"compile_s", "env_steps_per_s", "seconds"}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A run on one device."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    training.Trainer(toys.echo(), folder, "laptop", WORLDS, devices=1, **SMALL).run(steps=STEPS)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_two_devices_learn_what_one_does(processes, alone, tmp_path):
    """The same worlds, the same minibatches: sums of floats in another order are all that differs."""
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count={2 // processes}"
    # The engine c needs more threads where it has two devices.
    env = os.environ | {"PYTHONPATH": str(ROOT), "XLA_FLAGS": flags, "NPROC": "8"}
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    words = [
        [sys.executable, "-c", CODE, str(processes), str(i), str(port), str(tmp_path / "run")] for i in range(processes)
    ]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    started = [subprocess.Popen(line, cwd=ROOT, env=env, **pipes) for line in words]
    for one in started:
        _, printed = one.communicate(timeout=300)
        assert one.returncode == 0, printed
    weights = [training.Policy.load(folder).params for folder in (alone, tmp_path / "run")]
    for a, b in zip(*(jax.tree.leaves(x) for x in weights), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)
    rows = [
        [json.loads(line) for line in (x / "metrics.jsonl").read_text().splitlines()] for x in (alone, tmp_path / "run")
    ]
    assert [len(x) for x in rows] == [3, 3]
    for one, other in zip(*rows, strict=True):
        assert one.keys() - TIMES == other.keys() - TIMES
        for name in one.keys() - TIMES:
            np.testing.assert_allclose(one[name], other[name], atol=1e-4, err_msg=name)
