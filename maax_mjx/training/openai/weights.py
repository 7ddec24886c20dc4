"""Reading the published files of weights, without running anything that is in them."""

from __future__ import annotations

import posixpath
from pathlib import Path

import numpy as np

from maax_mjx.common.recorded import short

PICKLED = "policy_fn_and_args"
"""The one entry that is a pickle, of the arguments of a TensorFlow network; it is never read."""
USED = ("policy_net/", "policy_out/", "normalize_")
"""Beginnings of the names of what a policy plays with; the rest is its value function."""

Arrays = dict[str, np.ndarray]


def read_weights(path: str | Path) -> Arrays:
    """Reads the variables of a published policy, by name without the first part and the ":0" at the end.

    "policy/policy_net//lstm14/rnn/basic_lstm_cell/kernel:0" is "policy_net/lstm14/rnn/basic_lstm_cell/kernel", whatever
    the first part is. Nothing is unpickled.

    Args:
        path: a file .npz, with an array for every variable.

    Raises:
        ValueError: no such file, another one, a damaged one, or one with numbers that are not finite.
    """
    takes = "takes a policy of openai/multi-agent-emergence-environments, such as hide_and_seek_full.npz"
    if not Path(path).is_file():
        raise ValueError(f"path: got {str(path)!r}, which is not there; {takes}")
    try:
        with np.load(path, allow_pickle=False) as file:
            weights = {_named(key): np.asarray(file[key]) for key in file.files if key != PICKLED and _is_used(key)}
    # Damaged bytes make zip and NumPy raise errors of many kinds.
    except Exception as error:
        raise ValueError(
            f"path: got {path}, which is no .npz of arrays, or damaged ({short(str(error))}); {takes}"
        ) from None
    if not weights:
        raise ValueError(f"path: got {path}, without the variables of a policy; {takes}")
    for name, array in weights.items():
        if array.dtype.kind != "f" or not np.isfinite(array).all():
            raise ValueError(f"path: got {path}, whose {name!r} is not of finite numbers; {takes}")
    return {name: array.astype(np.float32) for name, array in weights.items()}


def _named(key: str) -> str:
    return posixpath.normpath(key).partition("/")[2].removesuffix(":0")


def _is_used(key: str) -> bool:
    return _named(key).startswith(USED)
