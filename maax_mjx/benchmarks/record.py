"""Under what conditions a benchmark ran, and its file."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import jax
from tqdm import tqdm

from maax_mjx.common.runtime import cores

Case = TypeVar("Case")
R = TypeVar("R")

PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "flax", "numpy", "orbax-checkpoint", "brax")


def conditions() -> dict[str, Any]:
    """Versions, devices and date."""
    return {
        "date": date.today().isoformat(),
        "python": platform.python_version(),
        "devices": [d.device_kind for d in jax.devices()],
        "cpus": cores(),
        "packages": {name: _version(name) for name in PACKAGES},
    }


def command(module: str, **options: Any) -> list[str]:
    """What runs a benchmark in a process of its own."""
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    return [sys.executable, "-m", f"maax_mjx.benchmarks.{module}", *words]


def write(path: Path | None, config: Any, rows: Sequence[Any]) -> None:
    """Writes rows (dataclasses) with their conditions as JSON; called after every row, so that none is lost."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    record = {"conditions": conditions(), "config": str(config), "rows": [asdict(row) for row in rows]}
    # Whole or not at all, wherever a run is killed.
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps(record, indent=1) + "\n")
    unfinished.replace(path)


def resume(path: Path | None, row: type[R]) -> list[R]:
    """The rows that an earlier run left in its file, to go on from; none where there is no file.

    Raises:
        ValueError: a file of another benchmark, or one that was measured on other devices or versions.
    """
    if path is None or not path.exists():
        return []
    record = json.loads(path.read_text())
    now = json.loads(json.dumps(conditions()))
    for name in ("devices", "cpus", "packages"):
        before = record["conditions"][name]
        # A file from before a package was listed says nothing of it.
        here = {package: now[name][package] for package in before} if name == "packages" else now[name]
        if before != here:
            raise ValueError(f"out: got {path} with {name} {before}; here they are {here}: takes a new file")
    try:
        return [row(**values) for values in record["rows"]]
    except TypeError as error:
        raise ValueError(f"out: got {path}; takes a file with rows of this benchmark ({error})") from error


def remaining(cases: Iterable[Case], rows: Sequence[Any], max_minutes: float | None) -> Iterator[Case]:
    """The cases of which no row is there yet, with progress, until the minutes are over.

    Args:
        cases: dataclasses or dicts; a row is of a case if it has its values in all fields of the case.
        rows: as `resume` gives them.
        max_minutes: no case is begun later than this.
    """
    begun = time.monotonic()
    todo = [case for case in cases if not any(_is_of(row, case) for row in rows)]
    for i, case in enumerate(tqdm(todo, unit="row", leave=False)):
        if max_minutes is not None and time.monotonic() - begun > 60 * max_minutes:
            tqdm.write(f"stopped after {max_minutes:g} minutes with {len(todo) - i} rows to go; run again to go on")
            return
        yield case


def _is_of(row: Any, case: Any) -> bool:
    return all(getattr(row, name) == value for name, value in (case if isinstance(case, dict) else vars(case)).items())


def fill(
    config: Any, rows: list[R], cases: Iterable[Case], measure: Callable[[Case], R], shown: Callable[[R], str]
) -> None:
    """Measures the cases that `rows` lack, writes each at once and prints it, until `config.max_minutes` are over.

    Args:
        config: a benchmark's options.
        rows: those that there are, to which the new ones are added.
        cases: see `remaining`; the most valuable first.
        measure: from a case to its row.
        shown: a line about a row.
    """
    for case in remaining(cases, rows, config.max_minutes):
        rows.append(measure(case))
        write(config.out, config, rows)
        tqdm.write(shown(rows[-1]))


def sweep(
    config: Any,
    row: type[R],
    key_fields: Sequence[str],
    cases: Iterable[tuple[Any, ...]],
    measure: Callable[..., R],
    shown: Callable[[R], str],
) -> None:
    """`fill` of what `config.out` has, with cases that are the values of some fields.

    Args:
        config: a benchmark's options.
        row: the class of its rows.
        key_fields: the fields of a row by which the cases are told apart.
        cases: their values, the most valuable first.
        measure: from these values to a row.
        shown: a line about a row.
    """
    named = (dict(zip(key_fields, case, strict=True)) for case in cases)
    fill(config, resume(config.out, row), named, lambda case: measure(*case.values()), shown)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
