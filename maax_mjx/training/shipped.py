"""Trained policies that come with the package; docs/emergence.md says how each was trained and what it does."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "policies"
ENDING = ".policy"


def policies() -> tuple[str, ...]:
    """Returns the names of the policies that come with the package, for `Policy.load`."""
    return tuple(sorted(x.relative_to(FOLDER).with_suffix("").as_posix() for x in FOLDER.rglob(f"*{ENDING}")))


def file_of(path: Path) -> Path:
    """Returns the file that a path or a shipped policy's name stands for; what is there comes before a name."""
    shipped = FOLDER / f"{path.as_posix()}{ENDING}"
    return shipped if not path.exists() and path.as_posix() in policies() else path
