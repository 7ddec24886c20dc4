"""Whether worlds fit the memory, asked before they are made: a system without any left may end the process unasked."""

from __future__ import annotations

import os
from collections.abc import Sequence

import jax

from maax_mjx.core.env import Environment

LARGE = 1_000_000
"""Bytes of a large state. Where as many of these would fit, no state is traced to be measured."""


def check_memory(argument: str, env: Environment, n_worlds: int, devices: Sequence[jax.Device]) -> None:
    """Refuses more worlds than the devices have memory for.

    Args:
        argument: name of the argument that says how many worlds.
        env: their environment.
        n_worlds: how many worlds, in equal shares on the devices.
        devices: the devices, also those of other processes. Those of a CPU share its memory.

    Raises:
        ValueError: states that alone fill the memory.
    """
    # A process may ask its own devices alone.
    mine = next(device for device in devices if device.process_index == jax.process_index())
    stats = (mine.memory_stats() or {}) if mine.platform != "cpu" else {}
    limit = stats.get("bytes_limit")
    memory = limit * len(devices) if limit else os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if n_worlds * LARGE < memory:
        return
    size = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(env.state_shape))
    if n_worlds * size > memory:
        raise ValueError(
            f"{argument}: got {n_worlds:,}; takes fewer than {memory // size:,}: states of {size / 1e3:.0f} kB each "
            f"would fill the memory of {memory / 1e9:.0f} GB"
        )
