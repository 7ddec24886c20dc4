"""Under what conditions a benchmark ran, and its file."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "flax", "numpy")


def conditions() -> dict[str, Any]:
    """Versions, devices and date."""
    return {
        "date": date.today().isoformat(),
        "python": platform.python_version(),
        "devices": [d.device_kind for d in jax.devices()],
        "cpus": os.cpu_count(),
        "packages": {name: _version(name) for name in PACKAGES},
    }


def write(path: Path | None, config: Any, rows: Sequence[Any]) -> None:
    """Writes rows (dataclasses) with their conditions as JSON; called after every row, so that none is lost."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    record = {"conditions": conditions(), "config": str(config), "rows": [asdict(row) for row in rows]}
    path.write_text(json.dumps(record, indent=1) + "\n")


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
