"""What importing and making an environment must leave alone."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import jax, maax_mjx as maax
from jax._src import xla_bridge
env = maax.make("standard")
env.model
assert not xla_bridge.backends_are_initialized(), "a JAX backend was initialised"
"""


def test_import_and_make_do_not_initialise_a_backend_and_print_nothing():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
