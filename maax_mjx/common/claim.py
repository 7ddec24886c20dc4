"""A file that one process at a time holds."""

from __future__ import annotations

from pathlib import Path
from typing import IO


class Claim:
    """A lock between processes, which ends with the process that holds it, however that ends.

    Objects of one process do not keep each other out. Where the system has no such locks, as Windows, nobody is kept
    out.

    Args:
        path: the file, made by `take`.
    """

    def __init__(self, path: Path):
        self._path = path
        self._file: IO[str] | None = None

    def take(self) -> bool:
        """Takes it, or keeps it; returns whether no other process has it.

        Raises:
            OSError: a file that cannot be written.
        """
        try:
            import fcntl
        except ImportError:
            return True
        if self._file is not None:
            return True
        file = self._path.open("w")
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):  # which of them says that it is held depends on the system
            file.close()
            return False
        except OSError:
            # A file system without locks.
            file.close()
            return True
        self._file = file
        return True

    def give_up(self) -> None:
        """Lets others take it; nothing if it was not taken."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def __del__(self) -> None:
        self.give_up()
