"""Files that are written completely or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

UNFINISHED: set[Path] = set()
"""Files that are being written, for an interrupt that ends the process to delete."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yields a temporary path to write to, which is moved to `path` once the file is complete.

    Every writer has a temporary path of its own: of several that write the same file, the last one's stays.
    """
    part = path.with_name(f".{path.stem}.{uuid4().hex[:12]}{path.suffix}")
    UNFINISHED.add(part)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
        UNFINISHED.discard(part)
