"""Recordings: what pictures need of some worlds over time, and the file of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import jax
import numpy as np
from flax import struct

from maax_mjx.common.annotated import check_value
from maax_mjx.common.whole import whole
from maax_mjx.core.state import State

KEPT = ("data", "world", "reward", "step", "mechanics")
FORMAT = 1
META = "meta"
DESCRIBED = {"format": int, "maax_mjx": str, "env": str, "overrides": dict}
"""What every file says of itself: format, version, the game's name, and values of its config's fields as texts."""


class Recording(struct.PyTreeNode):
    """Some worlds of a batch over time, as `maax.record` gives it.

    Attributes:
        states: every field has the leading axes (n_frames, n_worlds).
        episode_return: (n_frames, n_worlds, n_agents) reward summed over the running episode, or over the one that
            just ended.
    """

    states: State
    episode_return: Any

    def __repr__(self) -> str:
        n_frames, n_worlds = np.shape(self.states.step)
        return f"<Recording: {n_frames} frames of {n_worlds} worlds>"

    @classmethod
    def of(cls, frames: Sequence[tuple[State, Any]]) -> Recording:
        """The recording of frames, each stripped states and their returns with the leading axis (n_worlds,)."""
        return cls(*joined(frames))


def strip(state: State) -> State:
    """A state without what pictures do not need."""
    nothing: dict[str, Any] = dict.fromkeys(set(State.__dataclass_fields__) - set(KEPT))
    kept = {name: getattr(state, name) for name in KEPT}
    return State(**nothing, **(kept | {"data": state.data.replace(engine=())}))


def joined(frames: Sequence[tuple[State, Any]]) -> tuple[State, Any]:
    """Frames as one, with a leading axis of time."""
    return jax.tree.map(lambda *x: np.stack(x), *frames)


def leaves(tree: Any) -> dict[str, Any]:
    """A tree's arrays by the names that they have in a file."""
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def write(path: Path, meta: Mapping[str, Any], *trees: Any) -> None:
    """Writes trees of arrays, a `Recording` first, completely or not at all.

    Args:
        path: the .npz file.
        meta: what the file says of itself, as JSON takes it; `DESCRIBED` and more.
        trees: trees whose leaves have different names.
    """
    arrays: dict[str, Any] = {META: np.array(json.dumps({"format": FORMAT, **meta}))}
    for tree in trees:
        arrays |= leaves(tree)
    with whole(path) as part:
        np.savez_compressed(part, **arrays)


def read(path: Path, takes: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Reads what `write` wrote: what the file says of itself, and the arrays by name.

    Args:
        path: the file.
        takes: which file is meant, for the message.

    Raises:
        ValueError: no file, another one, a damaged one, or one of another format.
    """
    try:
        if Path(path).exists() and not is_zipfile(path):
            raise ValueError("no .npz")
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        meta = json.loads(str(arrays.pop(META)))
        for name, kind in DESCRIBED.items():
            check_value(name, meta[name], kind)
    except FileNotFoundError:
        raise ValueError(f"file: got {str(path)!r}, which is not there; {takes}") from None
    # Damaged bytes make zipfile, zlib and NumPy raise errors of a dozen kinds.
    except Exception as error:
        raise ValueError(f"file: got {path}, which is no saved rollout, or damaged ({error}); {takes}") from None
    if meta["format"] != FORMAT:
        raise ValueError(f"file: got {path} of format {meta['format']}; takes format {FORMAT}")
    return meta, arrays


def filled(path: Path, meta: Mapping[str, Any], arrays: Mapping[str, np.ndarray], template: Any, leading: int) -> Any:
    """Returns a tree of the arrays of a file.

    Args:
        path, meta, arrays: from `read`.
        template: the tree, with shapes and dtypes.
        leading: number of leading axes that the arrays have before the template's.

    Raises:
        ValueError: arrays that are missing or others than in the template.
    """
    wanted = leaves(template)
    lead = np.shape(next((arrays[name] for name in wanted if name in arrays), ()))[:leading]
    wrong = [
        name
        for name, x in sorted(wanted.items())
        if name not in arrays or arrays[name].shape != (*lead, *x.shape) or arrays[name].dtype != x.dtype
    ]
    if wrong:
        raise ValueError(
            f"file: got {path}, written by maax_mjx {meta['maax_mjx']}, without {', '.join(wrong)} as this version has "
            "them in this game; takes a file of this version and of the same game"
        )
    return jax.tree.unflatten(jax.tree.structure(template), [arrays[name] for name in wanted])
