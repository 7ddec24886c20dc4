"""What several processes of one program agree on; a single process agrees with itself at once."""

from __future__ import annotations

import jax
import numpy as np


def together(name: str) -> None:
    """Waits until all processes are here.

    Args:
        name: of the place, the same in all of them.
    """
    if jax.process_count() > 1:
        from jax.experimental.multihost_utils import sync_global_devices

        sync_global_devices(name)


def any_process(*flags: bool) -> tuple[bool, ...]:
    """Returns, for each flag, whether it is set in any process; all processes get the same."""
    if jax.process_count() == 1:
        return flags
    from jax.experimental.multihost_utils import process_allgather

    gathered = np.asarray(process_allgather(np.array(flags))).reshape(-1, len(flags))
    return tuple(bool(gathered[:, i].any()) for i in range(len(flags)))
