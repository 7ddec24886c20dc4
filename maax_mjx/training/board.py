"""Metrics of a run as TensorBoard reads them, written by tensorboardX."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maax_mjx.common.errors import MissingLibraryError, brought_by

COUNTERS = ("iteration", "steps")


class Board:
    """A folder of TensorBoard's event files; `tensorboard --logdir` shows them.

    Args:
        folder: the folder.

    Raises:
        MissingLibraryError: no tensorboardX.
    """

    def __init__(self, folder: Path):
        try:
            from tensorboardX import SummaryWriter
        except ImportError:
            raise MissingLibraryError(
                f"tensorboard: got True, and tensorboardX is not installed; {brought_by('tensorboard')}"
            ) from None
        self._new = SummaryWriter
        self._folder = folder
        self._writer: Any = None
        self._kept: int | None = None

    def forget(self, steps: int) -> None:
        """Drops what comes after so many env steps, from which the run goes on: it is made again."""
        self._kept = steps

    def add(self, row: Mapping[str, Any]) -> None:
        """Writes the numbers of an iteration, at its env steps."""
        if self._writer is None:
            first = row["steps"] if self._kept is None else self._kept + 1
            self._writer = self._new(str(self._folder), purge_step=first, flush_secs=10)
        for name, value in row.items():
            if name not in COUNTERS and value is not None:
                self._writer.add_scalar(_group(name), value, row["steps"])

    def close(self) -> None:
        """Waits until everything is written: a thread does it. What is added later goes into another file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def _group(name: str) -> str:
    """The name with that of its group before a slash, which TensorBoard shows together: episode_caught, kl."""
    group, _, rest = name.partition("_")
    return f"{group}/{rest}" if group in ("episode", "reward", "return", "explained", "entropy") else f"run/{name}"
