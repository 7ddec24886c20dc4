"""The JSON file of a benchmark: its rows, the run that measured each, and the conditions on this machine."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any, TypeVar

from maax_mjx.common.conditions import CHECKOUT, commit, conditions
from maax_mjx.common.whole import whole

RESULTS = CHECKOUT / "docs" / "results"
"""Folder of the committed results, which only a checkout has."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Base of all rows.

    Attributes:
        measured: date, commit and options of the run that measured the row; None in files from before rows had it.
    """

    measured: dict[str, Any] | None = None


R = TypeVar("R", bound=Measured)


def run_of(options: Any) -> dict[str, Any]:
    """Date, commit and options of a run that begins now, as `Measured.measured` holds them.

    Args:
        options: dataclass of a benchmark's options; `out` is left out, since it says nothing about the figures.
    """
    chosen = {name: value for name, value in asdict(options).items() if name != "out"}
    return {"date": date.today().isoformat(), "commit": commit(), "options": chosen}


def write(path: Path | None, rows: Sequence[Measured]) -> None:
    """Writes rows and the conditions as JSON, as a whole or not at all; nothing if `path` is None."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    listed = []
    for row in rows:
        values = asdict(row)
        # Last, so that a reader of the file meets the figures first.
        values["measured"] = values.pop("measured")
        listed.append(values)
    # A run may be killed at any moment.
    with whole(path) as part:
        part.write_text(json.dumps({"conditions": conditions(), "rows": listed}, indent=1, default=str) + "\n")


def read(path: Path) -> dict[str, Any]:
    """The record in a file, its "rows" as dicts.

    Raises:
        ValueError: the file is not a record.
    """
    try:
        record = json.loads(path.read_text())
        if not isinstance(record["conditions"], dict) or not isinstance(record["rows"], list):
            raise TypeError("conditions and rows")
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"path: got {path}; takes a benchmark's JSON record ({error!r})") from error
    return record


def read_rows(path: Path, row: type[R]) -> list[R]:
    """The rows in a file.

    Raises:
        ValueError: the file is not a record, or has rows of another benchmark.
    """
    try:
        return [row(**values) for values in read(path)["rows"]]
    except TypeError as error:
        raise ValueError(f"path: got {path}; takes a file with rows of this benchmark ({error})") from error


def resume(path: Path | None, row: type[R]) -> list[R]:
    """The rows that earlier runs left in a file, to go on from; none if there is no file.

    Raises:
        ValueError: the file is of another benchmark, or was measured on other devices or versions.
    """
    if path is None or not path.exists():
        return []
    before, now = read(path)["conditions"], conditions()
    # A file from before a package was listed says nothing about it.
    now["packages"] = {name: now["packages"].get(name) for name in before["packages"]}
    for name in ("devices", "cpus", "packages"):
        if before[name] != now[name]:
            raise ValueError(f"out: got {path} with {name} {before[name]}, here {now[name]}; takes a new file")
    return read_rows(path, row)
