"""Whether worlds fit the memory, asked before they are made: a system without any left may end the process unasked."""

from __future__ import annotations

import os

import jax

from maax_mjx.core.env import Environment

LEAST = 100_000
"""Bytes of a state that no game has: as long as states of so many would fit, none is traced to be measured."""


def check_memory(argument: str, env: Environment, n_worlds: int, devices: int = 1) -> None:
    """Refuses more worlds than the devices have memory for.

    Args:
        argument: name of the argument that says how many worlds.
        env: their environment.
        n_worlds: how many worlds.
        devices: how many devices they are spread over; those of a CPU share its memory.

    Raises:
        ValueError: states that alone fill the memory.
    """
    device = jax.devices()[0]
    stats = (device.memory_stats() or {}) if device.platform != "cpu" else {}
    limit = stats.get("bytes_limit")
    memory = limit * devices if limit else os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if n_worlds * LEAST < memory:
        return
    size = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(env.state_shape))
    if n_worlds * size > memory:
        raise ValueError(
            f"{argument}: got {n_worlds:,}; takes fewer than {memory // size:,}: states of {size / 1e3:.0f} kB each "
            f"would fill the memory of {memory / 1e9:.0f} GB"
        )
