"""Keys by name."""

from __future__ import annotations

from zlib import crc32

import jax
import numpy as np


def named_key(key: jax.Array, name: str) -> jax.Array:
    """The key of what is called `name`: draws by one name do not move those by another."""
    return jax.random.fold_in(key, np.uint32(crc32(name.encode())))
