"""Handling of Ctrl-C without tearing down compiled code while it runs."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
import time

from maax_mjx.common.whole import FOLDERS, UNFINISHED

EXIT_CODE = 130
SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Ctrl-C, and what schedulers of clusters send before they take a machine back."""
SAME_SECONDS = 1.0
"""Signals so close together are one: `timeout` and schedulers signal a process and its group."""


class Interrupt:
    """Handles Ctrl-C and SIGTERM instead of Python, which would raise during a compilation or a step, and crash there.

    Until `keep` is called there is nothing to write, and the process ends at once, compiling or not. After it, the
    first signal sets `asked`, for the work to end and be written, and another one ends the process.

    Attributes:
        asked: whether a signal came.
    """

    def __init__(self) -> None:
        self.asked = self._keeps = False

    def __enter__(self) -> Interrupt:
        # The bytes arrive at once, while Python's own handler waits for the compiler to return.
        self._bell, self._ear = socket.socketpair()
        self._bell.setblocking(False)
        self._handlers = {which: signal.signal(which, lambda *_: None) for which in SIGNALS}
        self._fd = signal.set_wakeup_fd(self._bell.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._fd)
        for which, handler in self._handlers.items():
            signal.signal(which, handler)
        self._bell.close()

    def keep(self) -> None:
        """Marks that there is something to write from now on."""
        self._keeps = True

    def _listen(self) -> None:
        first = 0.0
        while heard := self._ear.recv(1):
            if heard[0] not in SIGNALS or (self.asked and time.monotonic() - first < SAME_SECONDS):
                continue
            if self.asked or not self._keeps:
                _leave()
            self.asked, first = True, time.monotonic()
            _tell(
                "interrupted: ends what is being computed and writes what was done, which takes some seconds; "
                "Ctrl-C again leaves without the rest"
            )
        self._ear.close()


def _leave() -> None:
    for part in list(UNFINISHED):
        part.unlink(missing_ok=True)
    for folder in FOLDERS:
        with contextlib.suppress(OSError):  # it has files
            folder.rmdir()
    _tell("interrupted")
    sys.stdout.flush()
    # Skips Python's shutdown, at which threads that still compile would crash.
    os._exit(EXIT_CODE)


def _tell(message: str) -> None:
    print(f"\nmaax-mjx: {message}", file=sys.stderr, flush=True)
