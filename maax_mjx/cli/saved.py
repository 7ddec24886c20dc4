"""The file of a saved rollout: the states of some worlds over time, and how to make their environment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import maax_mjx as maax
from maax_mjx.cli.options import make_env
from maax_mjx.common.annotated import check_value
from maax_mjx.common.whole import whole
from maax_mjx.core.env import Environment
from maax_mjx.viewer import Recording
from maax_mjx.viewer.film import strip

FORMAT = 1
META = "meta"


def save(path: Path, env: str, overrides: Mapping[str, str], recording: Recording) -> None:
    """Writes a recording completely or not at all.

    Args:
        path: the .npz file.
        env: the environment's name.
        overrides: values of its config's fields, as texts.
        recording: the recording.
    """
    meta = {"format": FORMAT, "maax_mjx": maax.__version__, "env": env, "overrides": dict(overrides)}
    arrays: dict[str, Any] = {META: np.array(json.dumps(meta))} | _leaves(recording)
    with whole(path) as part:
        np.savez_compressed(part, **arrays)


def load(path: Path) -> tuple[Environment, Recording]:
    """Loads the recording and its environment, on the C engine, or on MJX-JAX if there is an accelerator.

    Raises:
        ValueError: a file that `save` did not write, or one of another version.
    """
    meta, arrays = _read(path)
    if meta["format"] != FORMAT:
        raise ValueError(f"file: got {path} of format {meta['format']}; takes format {FORMAT}")
    # Pictures do not depend on the engine.
    env = make_env(meta["env"], "c" if jax.default_backend() == "cpu" else "jax", meta["overrides"])
    template = Recording(strip(env.state_shape), jax.ShapeDtypeStruct((env.base.n_agents,), jnp.float32))
    wanted = _leaves(template)
    lead = np.shape(next(iter(arrays.values()), ()))[:2]
    wrong = [
        name
        for name, x in sorted(wanted.items())
        if name not in arrays or arrays[name].shape != (*lead, *x.shape) or arrays[name].dtype != x.dtype
    ]
    if wrong:
        raise ValueError(
            f"file: got {path}, written by maax_mjx {meta['maax_mjx']}, without {', '.join(wrong)} as maax_mjx "
            f"{maax.__version__} has them; takes a rollout.npz of this version"
        )
    return env, jax.tree.unflatten(jax.tree.structure(template), [arrays[name] for name in wanted])


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Reads what `save` wrote: how to make the environment, and the arrays by name.

    Raises:
        ValueError: no file, or another one, or a damaged one.
    """
    takes = "takes a rollout.npz of maax-mjx rollout"
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        meta = json.loads(str(arrays.pop(META)))
        for name, kind in (("format", int), ("maax_mjx", str), ("env", str), ("overrides", dict)):
            check_value(name, meta[name], kind)
        return meta, arrays
    except FileNotFoundError:
        raise ValueError(f"file: got {path}, which is not there; {takes}") from None
    # Damaged bytes make zipfile, zlib and NumPy raise errors of a dozen kinds.
    except Exception as error:
        raise ValueError(f"file: got {path}, which is no saved rollout, or damaged ({error}); {takes}") from None


def _leaves(tree: Any) -> dict[str, Any]:
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}
