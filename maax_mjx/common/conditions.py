"""The conditions of a measurement or a run: date, commit, versions and devices."""

from __future__ import annotations

import functools
import platform
import subprocess
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from maax_mjx.common.runtime import cores

CHECKOUT = Path(__file__).parents[2]
"""Folder of the git checkout that the package is in, if it is in one."""
PACKAGES = (
    "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "flax", "optax", "numpy", "orbax-checkpoint", "brax"
)  # fmt: skip


def conditions() -> dict[str, Any]:
    """Date, commit, versions and devices."""
    return {
        "date": date.today().isoformat(),
        "commit": commit(),
        "python": platform.python_version(),
        "devices": [d.device_kind for d in jax.devices()],
        "cpus": cores(),
        "packages": {name: _version(name) for name in PACKAGES},
    }


@functools.cache
def commit(checkout: Path = CHECKOUT) -> str | None:
    """Hash of the checkout's commit, "-dirty" behind it if the package differs from it; None outside a checkout.

    The first call of a process decides: later edits do not change what was imported.
    """
    # Only a repository of the package itself counts, not one around the environment that it is installed in.
    if not (checkout / ".git").exists():
        return None
    try:
        head = _git(checkout, "rev-parse", "HEAD")
        changed = _git(checkout, "status", "--porcelain", "--", "maax_mjx")
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{head}-dirty" if changed else head


def _git(folder: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", str(folder), *words], check=True, capture_output=True, text=True).stdout.strip()


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
