"""What `docs/upstream/` says of MuJoCo, MJX and Warp still holds in the versions in which it was seen."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "upstream"
SEEN = {"mujoco": ("4.0.",), "mujoco-mjx": ("3.17.",), "warp-lang": ("1.19.",), "jax": ("0.10.", "0.11.", "0.12.")}
"""Versions, by how they begin, in which the scripts showed what the pages say."""
SEEN_IN_JAX = {"shard_map": ("0.11.",), "two_threads": ("0.10.",)}
SLOW = ("two_threads",)
"""Takes minutes: run it by hand."""
NEEDS_WARP = ("warp_velocities", "warp_static", "hessian", "solver_iterations")
QUICK = ("midphase", "xml_digits", "import_prints")
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))


def installed(package):
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def unseen(name):
    """Installed packages of other versions than those in which a script showed what its page says."""
    seen = SEEN | ({"jax": SEEN_IN_JAX[name]} if name in SEEN_IN_JAX else {})
    if name not in NEEDS_WARP:
        del seen["warp-lang"]
    found = {package: installed(package) for package in seen}
    return {package: number for package, number in found.items() if not number.startswith(seen[package])}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in SCRIPTS if name not in SLOW],
)
def test_it_still_holds(name):
    """Each script asserts what its page is about; its page shows what it prints."""
    if others := unseen(name):
        pytest.skip(f"was not seen with {others}")
    command = [sys.executable, str(FOLDER / f"{name}.py")]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=os.environ | {"JAX_PLATFORMS": "cpu"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    # Warp's words about itself and its kernels are no part of it.
    printed = [line for line in done.stdout.splitlines() if not line.startswith(("Module ", "Warp ", "   "))]
    (shown,) = re.findall(r"```text\n(.*?)```", (FOLDER / f"{name}.md").read_text(), re.DOTALL)
    assert printed == shown.splitlines()


def test_every_script_has_a_page_that_links_to_it_and_is_in_the_index():
    pages = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem != "index")
    assert pages == SCRIPTS
    index = (FOLDER / "index.md").read_text()
    for name in SCRIPTS:
        assert f"\n[{name}.py]({name}.py)\n" in (FOLDER / f"{name}.md").read_text()
        assert f"]({name}.md)" in index
