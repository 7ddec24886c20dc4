"""Several devices and processes, by the script that users copy: the same worlds as on one device."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import maax_mjx as maax

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "notebooks" / "multi_device.py"
N_WORLDS, STEPS, ROUNDS = 4, 4, 2
SMALL = {"scenario": "'empty'", "outer": "'none'", "n_hiders": "1", "n_seekers": "0", "n_boxes": "0", "n_ramps": "0"}
SMALL |= {"horizon": "3"}


def start(folder, *options):
    """The script in a process of its own, on two virtual devices."""
    env = os.environ | {
        "PYTHONPATH": str(ROOT),
        "NPROC": "8",  # as the script sets it itself, where nobody has: the engine `c` calls back in threads
        "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2",
    }
    command = [sys.executable, str(SCRIPT), "--env", "standard", "--impl", "c", "--worlds", str(N_WORLDS)]
    command += ["--overrides", *(f"{name}={value}" for name, value in SMALL.items())]
    command += ["--steps", str(STEPS), "--rounds", str(ROUNDS), "--out", str(folder / "out.json"), *options]
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def finish(process, folder):
    printed, _ = process.communicate(timeout=400)
    assert process.returncode == 0, printed
    return json.loads((folder / "out.json").read_text()), printed


@pytest.fixture(scope="module")
def alone():
    """(n_worlds, nq) after the script's rounds on one device, without the script's ways to use several."""
    spec = importlib.util.spec_from_file_location("multi_device", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    env = maax.make("standard", impl="c", **{name: eval(value) for name, value in SMALL.items()})
    worlds = maax.Worlds(env, N_WORLDS)
    states = worlds.reset(jax.random.key(0), stagger=True)  # the script's own key
    for i in range(ROUNDS):
        params = {"push": np.float32([0.1 * i, 0, 0])}
        key = jax.random.fold_in(jax.random.key(0), i)
        states, _ = worlds.rollout(states, script.policy, STEPS, params, key=key, keep=("reward",))
    assert (states.counts["episodes"] >= 2).all()
    return np.asarray(states.data.qpos)


@pytest.mark.parametrize("way", ["shard_map", "pmap", "processes"])
def test_the_same_worlds_as_on_one_device(way, alone, tmp_path):
    options = ["--processes", "2"] if way == "processes" else ["--method", way, "--folder", str(tmp_path / "run")]
    found, printed = finish(start(tmp_path, *options), tmp_path)
    devices, processes = (4, 2) if way == "processes" else (2, 1)
    assert f"{N_WORLDS} worlds on {devices} devices of {processes} process(es)" in printed
    assert found["shape"] == ([2, 2] if way == "pmap" else [N_WORLDS])
    np.testing.assert_allclose(np.reshape(found["qpos"], alone.shape), alone, atol=1e-5)
    if way != "processes":
        env = maax.make("standard", impl="c", **{name: eval(value) for name, value in SMALL.items()})
        params = {"push": np.zeros(3, np.float32)}
        states, others = maax.Checkpoints(tmp_path / "run").restore(maax.Worlds(env, N_WORLDS), params=params)
        np.testing.assert_array_equal(states.data.qpos, np.float32(np.reshape(found["qpos"], alone.shape)))
        np.testing.assert_allclose(others["params"]["push"], [0.1 * ROUNDS, 0, 0], atol=1e-6)
