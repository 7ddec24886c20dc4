"""What is written of a run: trees by name, keys as numbers, and a few words about the game."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zlib import crc32

import jax
import numpy as np

from maax_mjx.common.checks import described
from maax_mjx.common.keys import as_key, keyless
from maax_mjx.core.identity import about_environment
from maax_mjx.parallel.worlds import Worlds

STATES, ABOUT, BOX = "states", "about", "tree"
RESERVED = (STATES, ABOUT, "metrics", "default")
"""Names of items that a user's trees cannot have: those of worlds, and Orbax's own."""


def named(tree: Any) -> dict[str, Any]:
    """Returns a tree's leaves by path, without empty ones, which Orbax does not take."""
    return {name_of(path): x for path, x in jax.tree.leaves_with_path(tree) if x.size}


def name_of(path: Any) -> str:
    """Returns a leaf's name, such as "data.qpos"."""
    return jax.tree_util.keystr(path, simple=True, separator=".")


def checksums(folder: Path) -> dict[str, int]:
    """Returns a number of the bytes of every file in a folder, by its path there."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    return {file.relative_to(folder).as_posix(): crc32(file.read_bytes()) for file in files}


def check_others(others: dict[str, Any]) -> None:
    """Refuses trees that cannot be saved.

    Raises:
        ValueError: a reserved name, or a leaf that is no array or number.
    """
    for name, tree in others.items():
        if name in RESERVED:
            raise ValueError(f"others: got the name {name!r}; takes others than {list(RESERVED)}")
        for path, leaf in jax.tree.leaves_with_path(tree):
            if not hasattr(leaf, "dtype") and not isinstance(leaf, int | float):
                raise ValueError(f"others: got {described(leaf)} at {name_of(path)!r} of {name!r}; takes arrays")


def boxed(others: dict[str, Any]) -> dict[str, Any]:
    """Wraps each tree in a dict, since Orbax does not take single arrays; a number stands for each empty array."""

    def full(x: Any) -> Any:
        return x if np.size(x) else np.zeros(1, x.dtype)

    return {name: {BOX: jax.tree.map(full, keyless(tree))} for name, tree in others.items()}


def unboxed(found: Any, like: Any) -> Any:
    """Returns a tree that was `boxed`, with the keys and empty arrays of `like`."""
    return jax.tree.map(lambda x, y: as_key(x, y) if np.size(y) else np.zeros(np.shape(y), y.dtype), found[BOX], like)


def about_worlds(worlds: Worlds) -> dict[str, Any]:
    """Returns what `Checkpoints.about` tells."""
    env = worlds.env
    return {**about_environment(env), "n_worlds": worlds.n_worlds, "engine": env.base.engine.impl}
