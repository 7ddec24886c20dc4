"""What importing and making an environment must leave alone, and what importing sets up."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CODE = """
import sys, jax, maax_mjx as maax
from jax._src import xla_bridge
env = maax.make("standard")
env.model
assert not xla_bridge.backends_are_initialized(), "a JAX backend was initialised"
assert not {"matplotlib", "viser", "av"} & set(sys.modules), "what only pictures need was imported"
"""
FOLDER = """
import sys, jax, maax_mjx
print(jax.config.jax_compilation_cache_dir, file=sys.stderr)
"""


def python(code, **variables):
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"} | variables
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False, env=env
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    return done.stderr.strip()


def test_import_and_make_do_not_initialise_a_backend_and_print_nothing():
    python(CODE)


@pytest.mark.parametrize("chosen", [False, True])
def test_compiled_programs_are_kept_where_the_user_says(chosen, tmp_path):
    own = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "own")} if chosen else {}
    folder = python(FOLDER, XDG_CACHE_HOME=str(tmp_path), **own)
    assert (
        folder == own["JAX_COMPILATION_CACHE_DIR"] if chosen else folder.startswith(str(tmp_path / "maax_mjx" / "xla-"))
    )
