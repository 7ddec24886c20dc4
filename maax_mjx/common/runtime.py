"""Settings of the JAX runtime that take effect only before its first use."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import platform
import sys
import warnings
from collections.abc import Iterator
from functools import cache
from hashlib import sha1
from pathlib import Path
from typing import Any

FEW_CORES = 3
"""CPU cores up to which `guard_small_hosts` sets the number of threads."""
XLA_CPU_THREADS = "3"
LEVEL = "MAAX_XLA_LEVEL"
NO_MEMORY = ("RESOURCE_EXHAUSTED", "Out of memory", "out of memory", "Failed to allocate", "bad_alloc")
"""Texts of errors that mean a lack of memory."""


def guard_small_hosts() -> None:
    """Gives XLA's CPU client more than two threads on a host of few cores.

    With exactly two, jaxlib 0.10 hangs for ever in large vmapped programs (seen in `jax.vmap(mjx.step)` of 64 worlds:
    every pool thread idle, the executable waiting). XLA reads NPROC when its client starts; a value set by the user is
    kept.
    """
    if cores() > FEW_CORES or "NPROC" in os.environ:
        return
    os.environ["NPROC"] = XLA_CPU_THREADS
    if _jax_runs():
        warnings.warn(
            f"JAX started before maax_mjx was imported, with {cores()} threads; with two jaxlib 0.10 hangs in large "
            "programs. Import maax_mjx before libraries that compute when they are imported, or set NPROC=3 in the "
            "environment",
            stacklevel=3,
        )


def _jax_runs() -> bool:
    """Whether JAX has started its backends."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and getattr(bridge, "backends_are_initialized", lambda: False)()


def cores() -> int:
    """Returns the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error means a lack of memory: of JAX, of Warp inside a JAX program, or of C++ on the host."""
    return isinstance(error, MemoryError) or any(words in str(error) for words in NO_MEMORY)


def keep_compiled_programs() -> None:
    """Makes JAX keep compiled programs between processes, in a folder per user and kind of processor.

    A folder set by the user is kept, and `JAX_ENABLE_COMPILATION_CACHE=0` turns the cache off. JAX never keeps programs
    with its own callbacks to the host; those of the `c` engine call it in another way (`physics/host_call.py`).
    """
    import jax

    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        # Programs are compiled for this processor, and machines with other processors may share the home folder.
        cpu = sha1(f"{platform.machine()} {_processor()}".encode()).hexdigest()[:12]
        jax.config.update("jax_compilation_cache_dir", str(home / "maax_mjx" / f"xla-{cpu}"))


def _processor() -> str:
    """Returns the features of the processor, as text."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return platform.processor()


def quick_compilation(level: int) -> dict[str, Any]:
    """Returns compiler options with which XLA compiles for the CPU in a third to half of the time.

    Measured on env steps of the engines `c` and `jax`: level 1 runs as fast as XLA's defaults, or faster; level 0 is a
    fifth slower, and compiles in half of the processor time of level 1.

    Args:
        level: level of optimisation; `MAAX_XLA_LEVEL=0` in the environment lowers it everywhere.

    Returns:
        The options that the installed XLA knows.
    """
    return dict(_known_options(min(level, int(os.environ.get(LEVEL, level)))))


def quick_on_cpu(level: int, platform: str | None = None) -> dict[str, Any] | None:
    """Returns the options of `quick_compilation` on a CPU; elsewhere None.

    Args:
        level: as there.
        platform: where the program will run, by default where JAX's default device is.
    """
    import jax

    return quick_compilation(level) if (platform or jax.default_backend()) == "cpu" else None


@cache
def _known_options(level: int) -> dict[str, Any]:
    import jax

    options: dict[str, Any] = {}
    for name, value in (("xla_backend_optimization_level", level), ("xla_cpu_use_fusion_emitters", False)):
        with contextlib.suppress(jax.errors.JaxRuntimeError, ValueError):
            jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
            options[name] = value
    return options


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """Keeps Python from looking for garbage: imports and traces make millions of objects that stay.

    Nearly a third of the import of MJX was spent on that, and a tenth of the first step.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def import_mjx() -> None:
    """Imports MJX and hides its messages about Warp: whether it is installed, and every kernel it loads."""
    with contextlib.suppress(ImportError), no_collection():
        import warp

        warp.config.log_level = warp.LOG_WARNING
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), no_collection():
        import mujoco.mjx  # noqa: F401
    for line in printed.getvalue().splitlines():
        if not line.startswith("Failed to import"):
            print(line)
