"""The wheel in an environment of its own, away from the checkout."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from maax_mjx.common.version import VERSION

ROOT = Path(__file__).parents[2]


def run(*command, cwd):
    """What a command prints; no checkout is on its path."""
    env = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run([*map(str, command)], cwd=cwd, env=env, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder of a virtual environment in which the wheel is installed; what it needs, it borrows from this one."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    wheel = [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(wheel, check=True, timeout=120)
    (wheel,) = folder.glob("*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", "venv", cwd=folder)
    run(*pip, "--python", folder / "venv", "install", "--no-deps", wheel, cwd=folder)
    (packages,) = (folder / "venv" / "lib").glob("python*/site-packages")
    # A path in a .pth file comes after the environment's own, and .pth files in it are not followed.
    (packages / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "venv"


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="hatchling builds the wheel")
def test_the_wheel_is_imported_and_runs(installed, tmp_path):
    where = run(installed / "bin" / "python", "-c", "import maax_mjx; print(maax_mjx.__file__)", cwd=tmp_path)
    assert Path(where.strip()).is_relative_to(installed)
    info = json.loads(run(installed / "bin" / "maax-mjx", "info", "--json", cwd=tmp_path))
    assert info["maax_mjx"] == VERSION
    assert info["engines"]["c"] == "works"
    small = ("--worlds=2", "--steps=3", "--show=1", "--json", f"--out={tmp_path / 'out'}", "--env.impl=c")
    small += ("--env.scenario=empty", "--env.n_boxes=0", "--env.n_ramps=0")
    played = json.loads(run(installed / "bin" / "maax-mjx", "rollout", "tag", *small, cwd=tmp_path))
    assert played
    assert (tmp_path / "out" / "rollout.npz").exists()
