"""What remembers in a network: GRU and LSTM, with their gradients through time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from maax_mjx.training.config import NetConfig

LONGEST = 10
"""Steps of a loop through time that are written out, so that nothing is copied from and to a loop's arrays. No preset
learns from longer chunks but "laptop", which has no memory."""

State = tuple[jax.Array, ...]
"""Arrays (..., n) of a memory; the last one is what the cell puts out."""


class Cell(NamedTuple):
    """A recurrent cell. It has four gates, which are one product of its input and its last output.

    Attributes:
        inputs: gates that the input has weights for; the last output has as many.
        states: arrays of its memory.
        joined: `(input, memory, bias) -> (kernel, bias)`, (n, inputs * n) twice and (inputs * n,) to (2 n, 4 n) and
            (4 n,): the weights of the one product.
        step: `(gates, state) -> state`, elementwise, where `gates` is (..., 4 n).
    """

    inputs: int
    states: int
    joined: Callable[[jax.Array, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]
    step: Callable[[jax.Array, State], State]


def _gru_joined(given: jax.Array, memory: jax.Array, bias: jax.Array) -> tuple[jax.Array, jax.Array]:
    # The candidate is made of the input and of the memory apart, since only the memory's part is reset.
    n = len(given)
    nothing = jnp.zeros((n, n))
    rows = [
        jnp.concatenate([given, nothing], axis=1),
        jnp.concatenate([memory[:, : 2 * n], nothing, memory[:, 2 * n :]], 1),
    ]
    return jnp.concatenate(rows), jnp.concatenate([bias, jnp.zeros(n)])


def _gru(gates: jax.Array, state: State) -> State:
    r, z, given, recalled = jnp.split(gates, 4, axis=-1)
    z = jax.nn.sigmoid(z)
    return ((1 - z) * jnp.tanh(given + jax.nn.sigmoid(r) * recalled) + z * state[0],)


def _lstm_joined(given: jax.Array, memory: jax.Array, bias: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jnp.concatenate([given, memory]), bias


def _lstm(gates: jax.Array, state: State) -> State:
    i, j, f, o = jnp.split(gates, 4, axis=-1)
    # The forget gate's bias is 1, as in TensorFlow's BasicLSTMCell.
    c = jax.nn.sigmoid(f + 1.0) * state[0] + jax.nn.sigmoid(i) * jnp.tanh(j)
    return c, jax.nn.sigmoid(o) * jnp.tanh(c)


CELLS = {"gru": Cell(3, 1, _gru_joined, _gru), "lstm": Cell(4, 2, _lstm_joined, _lstm)}


def memory_size(net: NetConfig) -> int:
    """Returns how many numbers one agent's actor, or critic, remembers."""
    return CELLS[net.core].states * net.hidden if net.core in CELLS else 0


class Core(nn.Module):
    """The memory of an actor or a critic, or none.

    Attributes:
        net: the form of the network.
    """

    net: NetConfig

    @nn.compact
    def __call__(self, x: jax.Array, memory: jax.Array, begins: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Runs through (n_steps, n_worlds, n_agents, hidden); the other arguments are those of `Tower`."""
        if self.net.core not in CELLS:
            return x, memory
        cell, n = CELLS[self.net.core], self.net.hidden
        given, bias = _Weights((n, cell.inputs * n), name="input")()
        recalled = self.param("memory", nn.initializers.orthogonal(), (n, cell.inputs * n))
        kernel, bias = cell.joined(given, recalled, bias)
        state = tuple(jnp.split(memory, cell.states, axis=-1))
        out, state = recurrent(cell, x.astype(self.net.compute), kernel, bias, state, begins)
        return out, jnp.concatenate(state, axis=-1)


class _Weights(nn.Module):
    """The weights of a layer."""

    shape: tuple[int, int]

    @nn.compact
    def __call__(self) -> tuple[jax.Array, jax.Array]:
        kernel = self.param("kernel", nn.initializers.orthogonal(), self.shape)
        return kernel, self.param("bias", nn.initializers.zeros, self.shape[1:])


def recurrent(
    cell: Cell, x: jax.Array, kernel: jax.Array, bias: jax.Array, state: State, begins: jax.Array
) -> tuple[jax.Array, State]:
    """Runs a cell through time.

    Args:
        cell: the cell.
        x: (n_steps, n_worlds, n_agents, n), its input, whose type is that of the products.
        kernel: (2 n, 4 n) float32, of the input and the last output.
        bias: (4 n,) float32.
        state: (n_worlds, n_agents, n) float32 each, before the first step.
        begins: (n_steps, n_worlds) bool, before which steps the memory is zeroed.

    Returns:
        What the cell puts out at every step, (n_steps, n_worlds, n_agents, n) in the type of `x`, and the state
        after the last one.
    """
    n = len(x)
    size = max(size for size in range(1, LONGEST + 1) if n % size == 0)
    if size == n:
        return _written_out(cell, x, kernel, bias, state, begins)

    def part(state: State, now: tuple[jax.Array, jax.Array]) -> tuple[State, jax.Array]:
        out, state = _written_out(cell, now[0], kernel, bias, state, now[1])
        return state, out

    parts = jax.tree.map(lambda a: a.reshape(n // size, size, *a.shape[1:]), (x, begins))
    state, out = jax.lax.scan(part, state, parts)
    return out.reshape(x.shape), state


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _written_out(
    cell: Cell, x: jax.Array, kernel: jax.Array, bias: jax.Array, state: State, begins: jax.Array
) -> tuple[jax.Array, State]:
    """Runs a cell through some steps, as `recurrent` does, without a loop.

    Its gradient is that of the steps. It is written out since what is kept for it is as small as can be: a step's
    products in the type of `x`; and since the kernel's gradient adds up in float32.
    """
    return _forward(cell, x, kernel, bias, state, begins)[0]


def _forward(
    cell: Cell, x: jax.Array, kernel: jax.Array, bias: jax.Array, state: State, begins: jax.Array
) -> tuple[tuple[jax.Array, State], Any]:
    narrow, bias, outs, kept = kernel.astype(x.dtype), bias.astype(x.dtype), [], []
    for t in range(len(x)):
        state = _zeroed(state, begins[t])
        both = jnp.concatenate([x[t], state[-1].astype(x.dtype)], axis=-1)
        gates = both @ narrow + bias
        kept.append((both, gates, state[:-1]))
        state = cell.step(gates.astype(jnp.float32), state)
        outs.append(state[-1].astype(x.dtype))
    return (jnp.stack(outs), state), (kept, narrow, begins)


def _backward(
    cell: Cell, kept: Any, gradients: tuple[jax.Array, State]
) -> tuple[jax.Array, jax.Array, jax.Array, State, None]:
    steps, kernel, begins = kept
    d_out, d_state = gradients
    n, d_kernel, d_bias, d_x = len(kernel) // 2, jnp.zeros(kernel.shape), jnp.zeros(kernel.shape[1]), []
    # Sums over rows as a product, of eight equal rows: a GPU's products read faster than XLA's sums do.
    ones = jnp.ones((8, d_out[0, ..., 0].size), d_out.dtype)
    for t, (both, gates, others) in reversed(list(enumerate(steps))):
        d_state = (*d_state[:-1], d_state[-1] + d_out[t].astype(jnp.float32))
        state = (*others, both[..., n:].astype(jnp.float32))
        _, pull = jax.vjp(cell.step, gates.astype(jnp.float32), state)
        d_gates, d_before = pull(d_state)
        rows, d_rows = both.reshape(-1, 2 * n), d_gates.astype(gates.dtype).reshape(-1, 4 * n)
        d_kernel += jnp.matmul(rows.T, d_rows, preferred_element_type=jnp.float32)
        d_bias += jnp.matmul(ones, d_rows, preferred_element_type=jnp.float32)[0]
        d_both = (d_rows @ kernel.T).reshape(both.shape)
        d_x.append(d_both[..., :n])
        d_state = (*d_before[:-1], d_before[-1] + d_both[..., n:].astype(jnp.float32))
        d_state = _zeroed(d_state, begins[t])
    return jnp.stack(d_x[::-1]), d_kernel, d_bias, d_state, None


_written_out.defvjp(_forward, _backward)


def _zeroed(state: State, begins: jax.Array) -> State:
    """Returns a state with zeros where an episode begins."""
    return jax.tree.map(lambda x: jnp.where(begins[..., None, None], 0.0, x), state)
