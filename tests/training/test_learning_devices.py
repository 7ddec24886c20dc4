"""Training on two virtual devices is training on one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
CODE = """
import json, sys, tempfile
sys.path.insert(0, "tests")
import jax
import numpy as np
from helpers import toys
from maax_mjx import training

small = {"net.width": 8, "net.hidden": 8, "net.heads": 2, "ppo.unroll": 4, "ppo.chunk": 2, "ppo.minibatches": 2}
found = []
for devices in (1, 2):
    folder = tempfile.mkdtemp() + "/run"
    one = training.Trainer(toys.echo(impl="jax"), folder, "laptop", 8, devices=devices, **small)
    one.run(steps=3 * 32)
    leaves = [np.asarray(x, float).ravel().tolist() for x in jax.tree.leaves(one.learner.weights)]
    found.append({"weights": leaves, "metrics": one.folder.rows()[-1], "devices": len(one.states.step.devices())})
json.dump(found, open(sys.argv[1], "w"))
"""
TIMES = {"compile_s", "env_steps_per_s", "seconds"}


@pytest.mark.slow
def test_two_devices_learn_what_one_does(tmp_path):
    """The same worlds, the same minibatches: sums of floats in another order are all that differs."""
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2"
    env = os.environ | {"PYTHONPATH": str(ROOT), "XLA_FLAGS": flags}
    out = tmp_path / "found.json"
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(out)], cwd=ROOT, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    one, two = json.loads(out.read_text())
    assert (one["devices"], two["devices"]) == (1, 2)
    for a, b in zip(one["weights"], two["weights"], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)
    assert one["metrics"].keys() - TIMES == two["metrics"].keys() - TIMES
    for name in one["metrics"].keys() - TIMES:
        np.testing.assert_allclose(one["metrics"][name], two["metrics"][name], atol=1e-4, err_msg=name)
