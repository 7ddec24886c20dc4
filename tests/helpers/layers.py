"""What layers make of the states of an environment that they are around: no reset is compiled for each of them."""

from __future__ import annotations

import functools


def observing(env, inner):
    """A function from states of `inner`, as it gives them, to those of `env`, which is `inner` under more layers."""
    around = env.layers[: len(env.layers) - len(inner.layers)]
    return lambda state: functools.reduce(lambda state, layer: layer.observe(state), reversed(around), state)
