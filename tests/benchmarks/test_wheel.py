"""The wheel holds code, assets and trained policies, and no results or pictures."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BYTES = 1_000_000
"""Of all but the policies, each of which has a bound of its own (`tests/training/test_shipped.py`)."""
POLICIES = "maax_mjx/training/policies/"


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="git says which files there are")
def test_the_package_is_small(tmp_path):
    """Compressed as a wheel is, without the time to build one."""
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard", "--", "maax_mjx"]
    names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    assert "maax_mjx/__init__.py" in names
    packed = tmp_path / "packed.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            if (ROOT / name).exists() and not name.startswith(POLICIES):
                archive.write(ROOT / name)
    assert packed.stat().st_size < BYTES
    assert {Path(name).suffix for name in names if name.startswith("maax_mjx/benchmarks/")} == {".py"}


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="hatchling builds the wheel")
def test_the_wheel_is_small(tmp_path):
    options = ["--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, str(ROOT)], check=True, timeout=120)
    (wheel,) = tmp_path.glob("*.whl")
    packed = zipfile.ZipFile(wheel)
    assert sum(x.compress_size for x in packed.infolist() if not x.filename.startswith(POLICIES)) < BYTES
    names = packed.namelist()
    assert {"maax_mjx/benchmarks/step.py", "maax_mjx/worldgen/assets/agent.xml", "maax_mjx/py.typed"} <= set(names)
    assert f"{POLICIES}quadrant/forts.policy" in names
    assert not [name for name in names if name.startswith(("docs", "tests"))]
