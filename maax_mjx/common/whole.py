"""Files that are written completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

UNFINISHED: set[Path] = set()
"""Files that are being written, for an interrupt that ends the process to delete."""
FOLDERS: list[Path] = []
"""Folders that were made for files, the inner ones first, for such an interrupt to delete those without any."""


@contextmanager
def whole(path: Path, argument: str = "path") -> Iterator[Path]:
    """Yields a temporary path to write to, which is moved to `path` once the file is complete.

    Every writer has a temporary path of its own: of several that write the same file, the last one's stays.

    Raises:
        ValueError: a place where no file can be written; the message begins with the name of the argument.
    """
    reason = _obstacle(path)
    if reason:
        raise ValueError(f"{argument}: got {str(path)!r}, {reason}; takes a file in a folder that can be written")
    part = path.with_name(f".{path.stem}.{uuid4().hex[:12]}{path.suffix}")
    UNFINISHED.add(part)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
        UNFINISHED.discard(part)


def _obstacle(path: Path) -> str:
    """Why no file can be written at a path; nothing if it can."""
    if path.is_dir():
        return "which is a folder"
    if not path.parent.is_dir():
        return f"and no folder {str(path.parent)!r} exists"
    return "" if os.access(path.parent, os.W_OK | os.X_OK) else f"and the folder {str(path.parent)!r} cannot be written"
