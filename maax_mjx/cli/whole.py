"""Files that are there whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

UNFINISHED: set[Path] = set()
"""What is being written, for an interrupt that ends the process to take away."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write what will be at `path` once it is complete, and not before."""
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    UNFINISHED.add(part)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
        UNFINISHED.discard(part)
