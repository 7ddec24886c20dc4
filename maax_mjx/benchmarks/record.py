"""Under what conditions a benchmark ran, and its file."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

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
    """Writes rows (dataclasses, or such rows read back) with their conditions as JSON.

    Called after every row, so that none is lost.
    """
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    record = {"conditions": conditions(), "config": str(config), "rows": [_plain(row) for row in rows]}
    path.write_text(json.dumps(record, indent=1) + "\n")


Key = tuple[Any, ...]


def measured(path: Path | None, key_fields: Sequence[str]) -> dict[Key, dict[str, Any]]:
    """The rows that a file holds already, by what tells them apart; none where there is no file."""
    if path is None or not path.exists():
        return {}
    rows = json.loads(path.read_text())["rows"]
    return {tuple(row[name] for name in key_fields): row for row in rows}


def sweep(
    config: Any,
    key_fields: Sequence[str],
    cases: Iterable[Key],
    measure: Callable[..., Any],
    shown: Callable[[Any], str],
) -> list[Any]:
    """Measures the cases that `config.out` lacks, and writes each at once, until `config.max_minutes` are over.

    Args:
        config: a benchmark's options.
        key_fields: the fields of a row by which the cases are told apart.
        cases: their values, the most valuable first.
        measure: from these values to a row.
        shown: a line about a row.

    Returns:
        The new rows.
    """
    until = time.monotonic() + 60 * config.max_minutes
    found: dict[Key, Any] = dict(measured(config.out, key_fields))
    missing = [case for case in cases if case not in found]
    new = []
    for case in tqdm(missing, unit="row"):
        if time.monotonic() > until:
            tqdm.write(f"{config.max_minutes:g} minutes are over; the same command goes on with {case}")
            break
        row = found[case] = measure(*case)
        new.append(row)
        tqdm.write(shown(row))
        write(config.out, config, list(found.values()))
    return new


def _plain(row: Any) -> dict[str, Any]:
    return row if isinstance(row, dict) else asdict(row)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
