"""What importing and making an environment must leave alone, and what importing sets up."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import pytest

from maax_mjx.common import runtime

CODE = """
import sys, jax, maax_mjx as maax
from jax._src import xla_bridge
env = maax.make("standard")
env.model
assert not xla_bridge.backends_are_initialized(), "a JAX backend was initialised"
assert not {"matplotlib", "viser", "av"} & set(sys.modules), "what only pictures need was imported"
assert not {"mujoco.mjx", "warp", "orbax.checkpoint"} & set(sys.modules), "what takes seconds was imported"
print(jax.config.jax_compilation_cache_dir, file=sys.stderr)
maax.make("standard", impl="c").engine
assert not {"mujoco.mjx", "warp"} & set(sys.modules), "what the engine c does without was imported"
maax.make("standard", impl="jax").engine
"""


def python(code, **variables):
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"} | variables
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False, env=env
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    return done.stderr.strip()


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [False, True])
def test_import_and_make(chosen, tmp_path):
    """They initialise no backend, print nothing, are quick, and have programs kept where the user says."""
    own = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "own")} if chosen else {}
    folder = python(CODE, XDG_CACHE_HOME=str(tmp_path), **own)
    assert (
        folder == own["JAX_COMPILATION_CACHE_DIR"] if chosen else folder.startswith(str(tmp_path / "maax_mjx" / "xla-"))
    )


@pytest.mark.parametrize(("cores", "chosen", "warns"), [(2, None, True), (2, "3", False), (16, None, False)])
def test_small_hosts_on_which_jax_runs_already_are_warned(cores, chosen, warns, monkeypatch, recwarn):
    jax.devices()
    monkeypatch.setattr(runtime, "cores", lambda: cores)
    monkeypatch.setenv("NPROC", chosen or "")
    if chosen is None:
        monkeypatch.delenv("NPROC")
    runtime.guard_small_hosts()
    assert bool([w for w in recwarn if "NPROC=3" in str(w.message)]) == warns
