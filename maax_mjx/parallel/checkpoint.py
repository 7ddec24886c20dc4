"""Saved states of a run, which continues from them bit for bit, on any number of devices."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from maax_mjx.common.checks import LONG, check_count, check_not_donated
from maax_mjx.common.runtime import is_out_of_memory
from maax_mjx.parallel.episodes import WorldsState
from maax_mjx.parallel.shards import AXIS
from maax_mjx.parallel.worlds import Worlds

STATES, BOX = "states", "tree"


class Checkpoints:
    """A folder of saved states that keeps the newest (Orbax).

    A save is either complete or absent: a run that is killed continues from the last one. Worlds are saved in their
    order, whatever devices they were on, and restored onto those of any `Worlds` of the same number and environment.
    With the same engine they continue bit for bit as if nothing had happened, except with `warp`, whose runs always
    differ in the last bits.

    Args:
        folder: the folder, created if it does not exist.
        keep: number of saves to keep.

    Raises:
        ValueError: an argument out of its range.
    """

    def __init__(self, folder: str | Path, keep: int = 2):
        # The import takes half a second; runs without saves skip it.
        import orbax.checkpoint as ocp

        keep = check_count("keep", keep, minimum=1)
        # Not in the background: on a CPU the next step would write into the memory that is being saved.
        options = ocp.CheckpointManagerOptions(max_to_keep=keep, enable_async_checkpointing=False)
        self.folder = Path(folder).absolute()
        self._orbax = ocp
        with _silence():
            self._manager = ocp.CheckpointManager(self.folder, options=options)

    @property
    def latest(self) -> int | None:
        """Number of the newest save; None without saves."""
        return self._manager.latest_step()

    def save(self, number: int, worlds: Worlds, states: WorldsState, **others: Any) -> None:
        """Saves states and anything else that belongs to the run.

        Args:
            number: number of this save, such as the env steps taken so far; greater than all before.
            worlds: the worlds of the states.
            states: states that are not donated yet.
            others: trees of arrays, such as a network's parameters, an optimiser's state, a key's data.

        Raises:
            ValueError: a number that is not greater than the latest, or states spread by pmap over several processes.
            RuntimeError: states that were donated.
        """
        latest = self.latest
        if check_count("number", number, maximum=LONG) <= (-1 if latest is None else latest):
            raise ValueError(f"number: got {number}; takes one greater than that of the latest save, {latest}")
        if worlds.shards.method == "pmap" and jax.process_count() > 1:
            raise ValueError("states: got those of pmap in several processes; takes method='shard_map' to save them")
        check_not_donated(states.step)
        flat = {name: worlds.flat(x) for name, x in _named(_keyless(states)).items()}
        trees = {STATES: flat, **_boxed(others)}
        args = self._orbax.args
        self._manager.save(number, args=args.Composite(**{k: args.StandardSave(v) for k, v in trees.items()}))

    def restore(self, worlds: Worlds, number: int | None = None, **others: Any) -> tuple[WorldsState, dict[str, Any]]:
        """Reads a save.

        Args:
            worlds: worlds whose devices get the states; as many, and of the same environment, as were saved.
            number: number of the save; None reads the latest.
            others: trees of the same shapes as in the save, such as freshly initialised parameters, one for each other
                item to read.

        Returns:
            The states, and a dict of the others.

        Raises:
            FileNotFoundError: no such save.
            ValueError: a save of other worlds, without one of the others, or damaged.
        """
        number = self.latest if number is None else number
        if number is None or number not in self._manager.all_steps():
            saved = sorted(self._manager.all_steps())
            has = f"has the saves {saved}" if saved else "has no saves yet"
            raise FileNotFoundError(f"number: got {number}, and {self.folder} {has}")
        like = worlds.states_shape
        wanted = _named(jax.eval_shape(_keyless, like))
        save = self.folder / str(number)
        if missing := sorted(name for name in others if not (save / name).is_dir()):
            raise ValueError(f"others: got {missing}, which are not in save {number} of {self.folder}; takes what is")
        self._check_same(wanted, self._read(number, lambda: self._metadata(save / STATES)))
        spread = {name: _target(worlds, x) for name, x in wanted.items()}
        trees = {STATES: spread, **_boxed(others)}
        args = self._orbax.args.Composite(
            **{name: self._orbax.args.StandardRestore(tree) for name, tree in trees.items()}
        )
        found = self._read(number, lambda: self._manager.restore(number, args=args))

        def leaf(path: Any, x: Any) -> Any:
            saved = found[STATES].get(_name(path))
            if not isinstance(saved, jax.Array):
                saved = worlds.shards.put(np.empty(x.shape, x.dtype) if saved is None else saved)
            return _as_key(saved, x)

        states = jax.tree.map_with_path(leaf, like)
        return states, {name: jax.tree.map(_as_key, found[name][BOX], tree) for name, tree in others.items()}

    def _metadata(self, item: Path) -> Any:
        """Returns the shapes and dtypes of a saved item by name."""
        # Not the manager's own method: in another process than the one that saved, it does not know the items.
        metadata = self._orbax.StandardCheckpointer().metadata(item).item_metadata
        if metadata is None:
            raise ValueError(f"no metadata of {item.name!r}")
        return metadata.tree

    def _read(self, number: int, read: Callable[[], Any]) -> Any:
        """Returns what `read` returns; a damaged save is one sentence, without Orbax's log and warnings.

        Raises:
            ValueError: a save that cannot be read.
        """
        with _silence():
            try:
                return read()
            except Exception as error:
                if is_out_of_memory(error):
                    raise
                reason = next(iter(str(error).splitlines()), "")[:200]
            # The error is gone by now: what it held, such as coroutines that nobody awaits, warns as it goes.
            gc.collect()
        raise ValueError(
            f"number: got {number} of {self.folder}, which is damaged, or has others of other shapes ({reason}); takes "
            f"one of the saves {sorted(self._manager.all_steps())} that can be read"
        )

    def _check_same(self, wanted: dict[str, Any], saved: Any) -> None:
        """Compares names and shapes."""
        shapes = {name: tuple(x.shape) for name, x in saved.items()}
        for name, x in wanted.items():
            if shapes.get(name) != x.shape:
                raise ValueError(
                    f"worlds: {self.folder} has {name} of shape {shapes.get(name)}, these worlds {x.shape}; takes as "
                    "many worlds of the same environment and engine as were saved"
                )
        if extra := sorted(set(shapes) - set(wanted)):
            raise ValueError(f"worlds: {self.folder} also has {', '.join(extra)}; takes the environment of the save")


@contextmanager
def _silence() -> Iterator[None]:
    """Silences Orbax's log: an item, unlike a whole save, has no metadata file of its own, and errors are raised."""
    from absl import logging

    level = logging.get_verbosity()
    logging.set_verbosity(logging.FATAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.set_verbosity(level)


def _named(tree: Any) -> dict[str, Any]:
    """Returns a tree's leaves by path, without empty ones, which Orbax does not take."""
    return {_name(path): x for path, x in jax.tree.leaves_with_path(tree) if x.size}


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


def _boxed(others: dict[str, Any]) -> dict[str, Any]:
    """Wraps each tree in a dict, since Orbax does not take single arrays."""
    return {name: {BOX: _keyless(tree)} for name, tree in others.items()}


def _is_key(x: Any) -> bool:
    return hasattr(x, "dtype") and jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


def _keyless(tree: Any) -> Any:
    """Replaces keys by their data."""
    return jax.tree.map(lambda x: jax.random.key_data(x) if _is_key(x) else x, tree)


def _as_key(x: Any, like: Any) -> Any:
    return jax.random.wrap_key_data(jnp.asarray(x)) if _is_key(like) else x


def _target(worlds: Worlds, x: Any) -> Any:
    """Returns where to read a leaf to: onto the devices if they share an array, else to the host."""
    if worlds.shards.method == "shard_map":
        return jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=NamedSharding(worlds.shards.mesh, P(AXIS)))
    return np.empty(x.shape, x.dtype)
