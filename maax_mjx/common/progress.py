"""Progress of long work on stderr: a bar in a terminal, a line now and then elsewhere."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

SECONDS = 10.0
"""Between two lines where stderr is no terminal."""
LINE = "{desc}: {n_fmt}/{total_fmt} {unit}{postfix}"


def progress(work: Iterable[Any] | None = None, desc: str | None = None, **options: Any) -> tqdm:
    """A bar that runs with some work, or is updated by hand; a file or a pipe gets a line every ten seconds instead.

    Args:
        work: what is iterated; None with `total=` and `update`.
        desc: what it is, in a few words.
        **options: as of `tqdm`.
    """
    lines = {} if sys.stderr.isatty() else {"file": _Lines(), "bar_format": LINE}
    return tqdm(work, desc, **options | lines)


class _Lines(io.TextIOBase):
    """A file for a bar, of which stderr gets a line at first, with every new description, and every ten seconds."""

    def __init__(self) -> None:
        self._due, self._desc = 0.0, ""

    def write(self, text: str) -> int:
        line = text.strip()
        desc = line.partition(":")[0]
        if line and (time.monotonic() >= self._due or desc != self._desc):
            self._due, self._desc = time.monotonic() + SECONDS, desc
            print(line, file=sys.stderr, flush=True)
        return len(text)
