"""Settings of the JAX runtime that have to be made before its first use."""

from __future__ import annotations

import contextlib
import io
import os

FEW_CORES = 3
XLA_CPU_THREADS = "3"


def guard_small_hosts() -> None:
    """Gives XLA's CPU client more than two threads on a host of few cores.

    With exactly two, jaxlib 0.10 hangs for ever in large vmapped programs (seen in `jax.vmap(mjx.step)` of 64 worlds:
    every pool thread idle, the executable waiting). XLA reads NPROC when its client starts; a value that the user
    set stays.
    """
    if _cores() <= FEW_CORES:
        os.environ.setdefault("NPROC", XLA_CPU_THREADS)


def _cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def import_mjx() -> None:
    """Imports MJX without what it prints: that Warp is not installed, or that it is, and every kernel it loads."""
    with contextlib.suppress(ImportError):
        import warp

        warp.config.log_level = warp.LOG_WARNING
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        import mujoco.mjx  # noqa: F401
    for line in printed.getvalue().splitlines():
        if not line.startswith("Failed to import"):
            print(line)
