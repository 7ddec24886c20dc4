"""Programs that call the host: kept between processes, of any shape, with errors as errors."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maax_mjx.physics import host_call

ROOT = Path(__file__).parents[2]
TWICE = """
import sys, jax
events = []
jax.monitoring.register_event_listener(lambda event, **_: events.append(event))
import maax_mjx as maax
env = maax.make("tag", impl="c", scenario="empty", n_boxes=0, n_ramps=0)
state = jax.jit(env.step)(jax.jit(env.reset)(jax.random.key(0)), env.sample_action(jax.random.key(1)))
print(sum("compilation_cache/cache_misses" in e for e in events), float(state.data.qpos.sum()))
"""

LEFT = """
import sys
import jax, jax.numpy as jnp, maax_mjx as maax
env = maax.make("tag", impl="c", scenario="empty", n_boxes=0, n_ramps=0, n_frames=10)
worlds = maax.Worlds(env, 32)
move = {"move": jnp.zeros((32, 4, 3))}
@jax.jit
def play(states, before):
    busy = jax.lax.fori_loop(0, before, lambda _, x: jnp.tanh(x @ x), jnp.ones((500, 500))).sum() * 1e-9
    first = {"move": move["move"] + busy}
    return jax.lax.fori_loop(0, 20_000, lambda _, x: worlds.step_fn(x, first), states)
states = worlds.reset(jax.random.key(0))
play.lower(states, 0).compile()
kept = [play(states, int(sys.argv[2]))][: int(sys.argv[1])]
print("left")
"""


class Halves:
    """Halves its first argument n times, and tells in how many calls; sums its second."""

    def __init__(self):
        self.calls = []

    def called(self, n, out, args):
        self.calls.append([(x.shape, x.dtype) for x in args])
        out[0][...] = args[0] / 2**n
        out[1][...] = args[1].sum(axis=-1)
        if (args[0] > 1e6).any():
            raise ValueError("too much to halve")

    def forget(self):
        self.calls.clear()


@pytest.fixture(params=["kept", "unkept"])
def halves(request, monkeypatch):
    monkeypatch.setattr(host_call, "is_known", lambda: request.param == "kept")
    user = type("User", (), {})()
    yield host_call.shared(hash(request.param), Halves, user), hash(request.param)
    del user


def call(number, x, y):
    like = [jax.ShapeDtypeStruct(x.shape, x.dtype), jax.ShapeDtypeStruct(y.shape[:-1], jnp.int32)]
    return host_call.host_call(number, 2, [x, y], like)


def test_the_structs_are_those_of_the_installed_jaxlib():
    assert host_call.is_known()


def test_all_rows_in_one_call(halves):
    callee, number = halves
    x, y = jnp.arange(6, dtype=jnp.float32).reshape(3, 2), jnp.arange(12, dtype=jnp.int32).reshape(3, 4)
    half, total = jax.jit(jax.vmap(lambda x, y: call(number, x, y)))(x, y)
    np.testing.assert_array_equal(half, np.asarray(x) / 4)
    np.testing.assert_array_equal(total, np.asarray(y).sum(axis=1))
    assert callee.calls == [[((3, 2), np.float32), ((3, 4), np.int32)]]


def test_empty_arrays_truths_and_loops(halves):
    _, number = halves
    empty, _ = jax.jit(lambda x, y: call(number, x, y))(jnp.zeros((0, 2)), jnp.ones((3, 2), bool))
    assert empty.shape == (0, 2)

    def body(x, _):
        return call(number, x, jnp.zeros((1, 2), bool))[0], None

    np.testing.assert_array_equal(jax.jit(lambda x: jax.lax.scan(body, x, length=3)[0])(jnp.ones(2)), [4.0**-3] * 2)


def test_errors_of_the_host_are_raised(halves):
    _, number = halves
    with pytest.raises(jax.errors.JaxRuntimeError, match="too much to halve"):
        jax.block_until_ready(jax.jit(lambda x, y: call(number, x, y))(jnp.full(2, 1e7), jnp.zeros((1, 2), bool)))


@pytest.mark.usefixtures("little_garbage")
def test_what_nobody_has_any_more_frees_its_memory_and_goes_in_the_end():
    user, callee = type("User", (), {})(), None
    callee = host_call.shared(7, Halves, user)
    assert host_call.shared(7, Halves, user) is callee
    callee.calls.append("memory")
    del user
    gc.collect()
    assert callee.calls == []
    assert 7 in host_call._callees
    host_call._latest.clear()
    del callee
    gc.collect()
    assert 7 not in host_call._callees


@pytest.mark.slow
def test_a_second_process_compiles_nothing(tmp_path):
    env = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
    }
    env["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    ran = [
        subprocess.run([sys.executable, "-c", TWICE], env=env, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    (misses, first), (none, second) = (re.fullmatch(r"(\d+) (\S+)\n", printed).groups() for printed in ran)
    assert int(misses) > 2
    assert int(none) == 0
    assert first == second


@pytest.mark.slow
@pytest.mark.parametrize(("kept", "before"), [(0, 0), (1, 0), (0, 500)])
def test_python_ends_while_programs_run(kept, before):
    """Nobody waits for their results, which somebody has or nobody, whose first call is still to come or not: they
    end, and nothing crashes or hangs."""
    code = [sys.executable, "-c", LEFT, str(kept), str(before)]
    ended = subprocess.run(code, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stdout) == (0, "left\n"), ended.stderr
