"""Handling of Ctrl-C without tearing down compiled code while it runs."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading

from maax_mjx.common.whole import UNFINISHED

EXIT_CODE = 130


class Interrupt:
    """Handles Ctrl-C instead of Python, which would raise during a compilation or a step, and crash there.

    Until `keep` is called there is nothing to write, and the process ends at once, compiling or not. After it, the
    first Ctrl-C sets `asked`, for the work to end and be written, and the second ends the process.

    Attributes:
        asked: whether Ctrl-C was pressed.
    """

    def __init__(self) -> None:
        self.asked = self._keeps = False

    def __enter__(self) -> Interrupt:
        # The bytes arrive at once, while Python's own handler waits for the compiler to return.
        self._bell, self._ear = socket.socketpair()
        self._bell.setblocking(False)
        self._handler = signal.signal(signal.SIGINT, lambda *_: None)
        self._fd = signal.set_wakeup_fd(self._bell.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._fd)
        signal.signal(signal.SIGINT, self._handler)
        self._bell.close()

    def keep(self) -> None:
        """Marks that there is something to write from now on."""
        self._keeps = True

    def _listen(self) -> None:
        while heard := self._ear.recv(1):
            if heard[0] != signal.SIGINT:
                continue
            if self.asked or not self._keeps:
                _leave()
            self.asked = True
            _tell(
                "interrupted: ends the step and writes what was done, which takes some seconds; "
                "Ctrl-C again leaves without the rest"
            )
        self._ear.close()


def _leave() -> None:
    for part in list(UNFINISHED):
        part.unlink(missing_ok=True)
    _tell("interrupted")
    sys.stdout.flush()
    # Skips Python's shutdown, at which threads that still compile would crash.
    os._exit(EXIT_CODE)


def _tell(message: str) -> None:
    print(f"\nmaax-mjx: {message}", file=sys.stderr, flush=True)
