"""What remembers in a network: GRU and LSTM, with their gradients through time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from maax_mjx.training.config import NetConfig

UNROLL = 8
"""Steps of a loop through time that are written out. The preset "gpu" has no more, so that nothing is copied from and
to the loop's arrays."""

State = tuple[jax.Array, ...]
"""Arrays (..., n) of a memory; the last one is what the cell puts out."""


class Cell(NamedTuple):
    """A recurrent cell.

    Attributes:
        gates: numbers that the cell is given per number that it puts out.
        states: arrays of its memory.
        step: `(given, recalled, state) -> state`, elementwise: `given` (..., gates * n) is made of the input and
            `recalled` of the last output.
    """

    gates: int
    states: int
    step: Callable[[jax.Array, jax.Array, State], State]


def _gru(given: jax.Array, recalled: jax.Array, state: State) -> State:
    (r, z, c), (hr, hz, hc) = (jnp.split(x, 3, axis=-1) for x in (given, recalled))
    z = jax.nn.sigmoid(z + hz)
    return ((1 - z) * jnp.tanh(c + jax.nn.sigmoid(r + hr) * hc) + z * state[0],)


def _lstm(given: jax.Array, recalled: jax.Array, state: State) -> State:
    i, j, f, o = jnp.split(given + recalled, 4, axis=-1)
    # The forget gate's bias is 1, as in TensorFlow's BasicLSTMCell.
    c = jax.nn.sigmoid(f + 1.0) * state[0] + jax.nn.sigmoid(i) * jnp.tanh(j)
    return c, jax.nn.sigmoid(o) * jnp.tanh(c)


CELLS = {"gru": Cell(3, 1, _gru), "lstm": Cell(4, 2, _lstm)}


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
        cell, n, dtype = CELLS[self.net.core], self.net.hidden, jnp.dtype(self.net.compute)
        ortho = nn.initializers.orthogonal()
        # The inputs of all steps in one product; only the memory's part is a loop.
        given = nn.Dense(cell.gates * n, dtype=dtype, kernel_init=ortho, name="input")(x)
        kernel = self.param("memory", ortho, (n, cell.gates * n)).astype(dtype)
        state = tuple(jnp.split(memory, cell.states, axis=-1))
        out, state = recurrent(cell, given, kernel, state, begins)
        return out, jnp.concatenate(state, axis=-1)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def recurrent(
    cell: Cell, given: jax.Array, kernel: jax.Array, state: State, begins: jax.Array
) -> tuple[jax.Array, State]:
    """Runs a cell through time.

    Its gradient is that of the loop. It is written out since the loop's derivative adds up the kernel's gradient step
    by step, a small product each, where one large product does; and since it keeps every intermediate result in
    float32.

    Args:
        cell: the cell.
        given: (n_steps, n_worlds, n_agents, gates * n).
        kernel: (n, gates * n), in the type of `given`.
        state: (n_worlds, n_agents, n) float32 each, before the first step.
        begins: (n_steps, n_worlds) bool, before which steps the memory is zeroed.

    Returns:
        What the cell puts out at every step, (n_steps, n_worlds, n_agents, n) in the type of `given`, and the state
        after the last one.
    """
    return _forward(cell, given, kernel, state, begins)[0]


def _forward(
    cell: Cell, given: jax.Array, kernel: jax.Array, state: State, begins: jax.Array
) -> tuple[tuple[jax.Array, State], Any]:
    def step(state: State, now: tuple[jax.Array, jax.Array]) -> tuple[State, tuple[jax.Array, State, jax.Array]]:
        given, begins = now
        state = _zeroed(state, begins)
        # Kept for the gradients as they are read there.
        before = (*state[:-1], state[-1].astype(kernel.dtype))
        recalled = before[-1] @ kernel
        state = cell.step(given.astype(jnp.float32), recalled.astype(jnp.float32), state)
        return state, (state[-1].astype(given.dtype), before, recalled)

    last, (out, before, recalled) = jax.lax.scan(step, state, (given, begins), unroll=UNROLL)
    return (out, last), (given, recalled, kernel, before, begins)


def _backward(cell: Cell, kept: Any, gradients: tuple[jax.Array, State]) -> tuple[jax.Array, jax.Array, State, None]:
    given, recalled, kernel, before, begins = kept
    d_out, d_last = gradients

    def step(d_state: State, now: Any) -> tuple[State, Any]:
        d_out, given, recalled, before, begins = now
        d_state = (*d_state[:-1], d_state[-1] + d_out.astype(jnp.float32))
        before = tuple(x.astype(jnp.float32) for x in before)
        _, pull = jax.vjp(cell.step, given.astype(jnp.float32), recalled.astype(jnp.float32), before)
        d_given, d_recalled, d_before = pull(d_state)
        # An LSTM adds the two, so that they are one array, which is kept once.
        apart = () if d_given is d_recalled else d_given.astype(given.dtype)
        d_recalled = d_recalled.astype(kernel.dtype)
        from_h = (d_recalled @ kernel.T).astype(jnp.float32)
        return _zeroed((*d_before[:-1], d_before[-1] + from_h), begins), (apart, d_recalled)

    xs = (d_out, given, recalled, before, begins)
    d_first, (apart, d_recalled) = jax.lax.scan(step, d_last, xs, reverse=True, unroll=UNROLL)
    d_kernel = jnp.einsum("twan,twag->ng", before[-1], d_recalled, preferred_element_type=jnp.float32)
    d_given = d_recalled.astype(given.dtype) if isinstance(apart, tuple) else apart
    return d_given, d_kernel.astype(kernel.dtype), d_first, None


recurrent.defvjp(_forward, _backward)


def _zeroed(state: State, begins: jax.Array) -> State:
    """Returns a state with zeros where an episode begins."""
    return jax.tree.map(lambda x: jnp.where(begins[..., None, None], 0.0, x), state)
