"""Memories: what the cells compute, against NumPy, and their own gradients, against those of a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

from maax_mjx.training.cores import CELLS, recurrent

T, W, A, N = 6, 3, 2, 5


def drawn(cell, dtype=jnp.float32):
    """`given`, `kernel`, `state`, `begins`, and weights for a sum of what comes out."""
    keys = jax.random.split(seeds.key(0), 5)
    given = jax.random.normal(keys[0], (T, W, A, cell.gates * N)).astype(dtype)
    kernel = (0.5 * jax.random.normal(keys[1], (N, cell.gates * N))).astype(dtype)
    state = tuple(jax.random.normal(key, (W, A, N)) for key in jax.random.split(keys[2], cell.states))
    begins = jnp.zeros((T, W), bool).at[0, 1].set(True).at[3, 0].set(True).at[5, 2].set(True)
    return given, kernel, state, begins, jax.random.normal(keys[4], (T, W, A, N))


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def in_numpy(core, given, kernel, state, begins):
    """The loop, gate by gate: an LSTM as TensorFlow's BasicLSTMCell, a GRU as Keras' with reset after the product."""
    given, kernel, state = np.float64(given), np.float64(kernel), [np.float64(x) for x in state]
    outs = []
    for t in range(len(given)):
        state = [np.where(np.asarray(begins[t])[:, None, None], 0, x) for x in state]
        recalled = state[-1] @ kernel
        if core == "lstm":
            i, j, f, o = np.split(given[t] + recalled, 4, axis=-1)
            c = sigmoid(f + 1) * state[0] + sigmoid(i) * np.tanh(j)
            state = [c, sigmoid(o) * np.tanh(c)]
        else:
            (r, z, c), (hr, hz, hc) = np.split(given[t], 3, axis=-1), np.split(recalled, 3, axis=-1)
            z = sigmoid(z + hz)
            state = [(1 - z) * np.tanh(c + sigmoid(r + hr) * hc) + z * state[0]]
        outs.append(state[-1])
    return np.stack(outs), state


@pytest.mark.parametrize("core", CELLS)
def test_cells_compute_what_they_are_named_for(core):
    *given, _ = drawn(CELLS[core])
    out, last = jax.jit(recurrent, static_argnums=0)(CELLS[core], *given)
    expected, end = in_numpy(core, *given)
    np.testing.assert_allclose(out, expected, atol=1e-5)
    for x, y in zip(last, end, strict=True):
        np.testing.assert_allclose(x, y, atol=1e-5)


def plain(cell, given, kernel, state, begins):
    """The loop that JAX differentiates by itself."""
    outs = []
    for t in range(T):
        state = tuple(jnp.where(begins[t][:, None, None], 0.0, x) for x in state)
        state = cell.step(given[t], state[-1] @ kernel, state)
        outs.append(state[-1])
    return jnp.stack(outs), state


@pytest.mark.parametrize("core", CELLS)
def test_gradients_are_those_of_the_loop(core):
    cell = CELLS[core]
    *given, begins, weigh = drawn(cell)

    def total(loop, *given):
        out, last = loop(cell, *given, begins)
        return (out * weigh).sum() + sum((x**2).sum() for x in last)

    gradients = [
        jax.jit(jax.grad(lambda *x, loop=loop: total(loop, *x), (0, 1, 2)))(*given) for loop in (recurrent, plain)
    ]
    assert all(float(jnp.abs(x).max()) > 0.1 for x in jax.tree.leaves(gradients))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=2e-5), *gradients)


@pytest.mark.parametrize("core", CELLS)
def test_in_bfloat16_gradients_are_close_and_have_its_type(core):
    cell = CELLS[core]
    given, kernel, state, begins, weigh = drawn(cell)

    def total(given, kernel):
        return (recurrent(cell, given, kernel, state, begins)[0] * weigh).sum()

    gradient = jax.jit(jax.grad(total, (0, 1)))
    exact, rough = gradient(given, kernel), gradient(*(x.astype(jnp.bfloat16) for x in (given, kernel)))
    for x, y in zip(exact, rough, strict=True):
        assert y.dtype == jnp.bfloat16
        np.testing.assert_allclose(np.float32(y), x, atol=0.05 * float(jnp.abs(x).max()))
