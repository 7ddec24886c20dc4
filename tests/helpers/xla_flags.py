"""Flags under which XLA compiles fast: tests compile much and compute little."""

from __future__ import annotations

import os
import subprocess
import sys

# On a CPU the older emitters of fusions compile in a third of the time; jaxlib 0.12 has them no more.
CANDIDATES = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_parallel_codegen_split_count=1",
    "--xla_cpu_use_fusion_emitters=false",
)
FOUND = "MAAX_TEST_XLA_FLAGS"
"""In the environment, what was found, for the processes that tests run in."""


def quick() -> str:
    """Those flags that the installed XLA takes: it ends a process that sets another."""
    if FOUND not in os.environ:
        known = list(CANDIDATES)
        while known and not _takes(known):
            known.pop()
        os.environ[FOUND] = " ".join(known)
    return os.environ[FOUND]


def _takes(flags: list[str]) -> bool:
    environment = os.environ | {"XLA_FLAGS": " ".join(flags), "JAX_PLATFORMS": "cpu"}
    tried = subprocess.run(
        [sys.executable, "-c", "import jax; jax.devices()"], env=environment, capture_output=True, check=False
    )
    return tried.returncode == 0
