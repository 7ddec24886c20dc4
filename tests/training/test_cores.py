"""Memories: what the cells compute, against NumPy, and their own gradients, against those of a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

from maax_mjx.training.cores import CELLS, LONGEST, recurrent

W, A, N = 3, 2, 5
LENGTHS = (1, 6, 2 * LONGEST, 2 * LONGEST + 1)
"""One step, some that are written out, and those in parts: of many steps, and of few."""


def drawn(cell, n_steps=6):
    """`x`, the layers' weights, `state`, `begins`, and weights for a sum of what comes out."""
    keys = jax.random.split(seeds.key(0), 7)
    x = jax.random.normal(keys[0], (n_steps, W, A, N))
    given, memory = (0.5 * jax.random.normal(key, (N, cell.inputs * N)) for key in keys[1:3])
    bias = 0.5 * jax.random.normal(keys[3], (cell.inputs * N,))
    state = tuple(jax.random.normal(key, (W, A, N)) for key in jax.random.split(keys[4], cell.states))
    begins = jax.random.bernoulli(keys[5], 0.2, (n_steps, W)).at[0].set([False, True, False]).at[-1, 2].set(True)
    return x, (given, memory, bias), state, begins, jax.random.normal(keys[6], (n_steps, W, A, N))


def ours(cell, x, weights, state, begins):
    return recurrent(cell, x, *cell.joined(*weights), state, begins)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def in_numpy(core, x, weights, state, begins):
    """The loop, gate by gate: an LSTM as TensorFlow's BasicLSTMCell, a GRU as Keras' with reset after the product."""
    (given, memory, bias), state = map(np.float64, weights), [np.float64(x) for x in state]
    outs = []
    for t in range(len(x)):
        state = [np.where(np.asarray(begins[t])[:, None, None], 0, x) for x in state]
        now, recalled = np.float64(x[t]) @ given + bias, state[-1] @ memory
        if core == "lstm":
            i, j, f, o = np.split(now + recalled, 4, axis=-1)
            c = sigmoid(f + 1) * state[0] + sigmoid(i) * np.tanh(j)
            state = [c, sigmoid(o) * np.tanh(c)]
        else:
            (r, z, c), (hr, hz, hc) = np.split(now, 3, axis=-1), np.split(recalled, 3, axis=-1)
            z = sigmoid(z + hz)
            state = [(1 - z) * np.tanh(c + sigmoid(r + hr) * hc) + z * state[0]]
        outs.append(state[-1])
    return np.stack(outs), state


@pytest.mark.parametrize("n_steps", LENGTHS)
@pytest.mark.parametrize("core", CELLS)
def test_cells_compute_what_they_are_named_for(core, n_steps):
    *given, _ = drawn(CELLS[core], n_steps)
    out, last = jax.jit(ours, static_argnums=0)(CELLS[core], *given)
    expected, end = in_numpy(core, *given)
    np.testing.assert_allclose(out, expected, atol=1e-5)
    for x, y in zip(last, end, strict=True):
        np.testing.assert_allclose(x, y, atol=1e-5)


def plain(cell, x, weights, state, begins):
    """The loop that JAX differentiates by itself."""
    kernel, bias = cell.joined(*weights)
    outs = []
    for t in range(len(x)):
        state = tuple(jnp.where(begins[t][:, None, None], 0.0, x) for x in state)
        state = cell.step(jnp.concatenate([x[t], state[-1]], -1) @ kernel + bias, state)
        outs.append(state[-1])
    return jnp.stack(outs), state


@pytest.mark.parametrize("n_steps", LENGTHS)
@pytest.mark.parametrize("core", CELLS)
def test_gradients_are_those_of_the_loop(core, n_steps):
    cell = CELLS[core]
    *given, begins, weigh = drawn(cell, n_steps)

    def total(loop, *given):
        out, last = loop(cell, *given, begins)
        return (out * weigh).sum() + sum((x**2).sum() for x in last)

    gradients = [jax.jit(jax.grad(lambda *x, loop=loop: total(loop, *x), (0, 1, 2)))(*given) for loop in (ours, plain)]
    assert all(float(jnp.abs(x).max()) > 0.1 for x in jax.tree.leaves(gradients))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=2e-5), *gradients)


@pytest.mark.parametrize("core", CELLS)
def test_in_bfloat16_gradients_are_close_and_those_of_weights_in_float32(core):
    cell = CELLS[core]
    x, weights, state, begins, weigh = drawn(cell)

    def total(x, weights):
        return (ours(cell, x, weights, state, begins)[0] * weigh).sum()

    gradient = jax.jit(jax.grad(total, (0, 1)))
    exact, rough = gradient(x, weights), gradient(x.astype(jnp.bfloat16), weights)
    assert rough[0].dtype == jnp.bfloat16
    assert all(y.dtype == jnp.float32 for y in rough[1])
    for a, b in zip(jax.tree.leaves(exact), jax.tree.leaves(rough), strict=True):
        np.testing.assert_allclose(np.float32(b), a, atol=0.05 * float(jnp.abs(a).max()))
