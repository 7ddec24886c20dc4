"""Saved states of a run, which continues from them bit for bit, on any number of devices."""

from __future__ import annotations

import gc
import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from maax_mjx.common.checks import LONG, check_bool, check_count, described
from maax_mjx.common.keys import as_key, keyless
from maax_mjx.common.runtime import is_out_of_memory
from maax_mjx.core.identity import difference
from maax_mjx.parallel.episodes import WorldsState
from maax_mjx.parallel.saved import (
    ABOUT,
    BOX,
    STATES,
    about_worlds,
    boxed,
    check_others,
    checksums,
    name_of,
    named,
    unboxed,
)
from maax_mjx.parallel.shards import AXIS
from maax_mjx.parallel.worlds import Worlds


class Checkpoints:
    """A folder of saved states that keeps the newest (Orbax).

    A save is either complete or absent: a run that is killed continues from the last one. Worlds are saved in their
    order, whatever devices they were on, and restored onto those of any `Worlds` of the same game, but from `c` onto no
    other engine, nor back. As many, with the same engine, continue bit for bit as if nothing had happened, except with
    `warp`, whose runs always differ in the last bits. `about` has the game and its config.

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
        if not isinstance(folder, str | Path):
            raise ValueError(f"folder: got {folder!r}; takes a path")
        if Path(folder).exists() and not Path(folder).is_dir():
            raise ValueError(f"folder: got {str(folder)!r}, which is a file; takes a folder, or a new one")
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

    def about(self, number: int | None = None) -> dict[str, Any]:
        """Reads what a save is of.

        Args:
            number: number of the save; None reads the latest.

        Returns:
            A dict with "n_worlds" and the "engine"; of a game that `maax.make` made also its name, "game", the fields
            of its config that differ from the defaults, "config", and those "defaults":
            `maax.make(about["game"], **about["config"])` makes it again, unless it has functions or modules, which are
            texts here. "layers" are texts of the wrappers around it, or of an environment of one's own. Empty for a
            save without worlds.

        Raises:
            FileNotFoundError: no such save.
            ValueError: a damaged save.
        """
        number = self._found(number)
        file = self.folder / str(number) / ABOUT / "metadata"
        return self._read(number, lambda: json.loads(file.read_text())) if file.exists() else {}

    def save(self, number: int, worlds: Worlds | None = None, states: WorldsState | None = None, **others: Any) -> None:
        """Saves states, or anything else that belongs to the run, or both.

        Args:
            number: number of this save, such as the env steps taken so far; greater than all before.
            worlds: the worlds of the states.
            states: states that are not donated yet.
            others: trees of arrays, such as a network's parameters, an optimiser's state, a key's data.

        Raises:
            ValueError: a number that is not greater than the latest, nothing to save, worlds without states, states of
                other worlds or spread by pmap over several processes, a reserved name, or what is no array.
            RuntimeError: states that were donated.
        """
        latest = self.latest
        if check_count("number", number, maximum=LONG) <= (-1 if latest is None else latest):
            raise ValueError(f"number: got {number}; takes one greater than that of the latest save, {latest}")
        if (worlds is None) != (states is None):
            raise ValueError("states: got worlds or states alone; takes both, or neither for a save without worlds")
        if states is None and not others:
            raise ValueError("others: got nothing to save; takes states, other trees of arrays, or both")
        check_others(others)
        args = self._orbax.args
        items = {name: args.StandardSave(tree) for name, tree in boxed(others).items()}
        if worlds is not None and states is not None:
            _check_worlds(worlds).check_states(states)
            if worlds.shards.method == "pmap" and jax.process_count() > 1:
                raise ValueError("states: got those of pmap in several processes; takes method='shard_map' there")
            flat = {name: worlds.flat(x) for name, x in named(keyless(states.replace(recent=()))).items()}
            items |= {STATES: args.StandardSave(flat), ABOUT: args.JsonSave(about_worlds(worlds))}
        self._manager.save(number, args=args.Composite(**items))
        if jax.process_index() == 0:
            self._sums(number).write_text(json.dumps(checksums(self.folder / str(number))))
            for file in self.folder.glob(".*.sums"):
                if file.stem.strip(".").isdecimal() and not (self.folder / file.stem.strip(".")).exists():
                    file.unlink()

    @overload
    def restore(
        self, worlds: Worlds, number: int | None = None, *, resize: bool = False, **others: Any
    ) -> tuple[WorldsState, dict[str, Any]]: ...
    @overload
    def restore(
        self, worlds: None = None, number: int | None = None, *, resize: bool = False, **others: Any
    ) -> tuple[None, dict[str, Any]]: ...
    def restore(
        self, worlds: Worlds | None = None, number: int | None = None, *, resize: bool = False, **others: Any
    ) -> tuple[WorldsState | None, dict[str, Any]]:
        """Reads a save.

        Args:
            worlds: worlds whose devices get the states, of the same game as were saved; None reads the others alone.
            number: number of the save; None reads the latest.
            resize: whether there may be more or fewer worlds than were saved: the first ones go on, and more begin
                with new episodes.
            others: trees of the same shapes and kinds of numbers as in the save, such as freshly initialised
                parameters, one for each other item to read.

        Returns:
            The states, None without worlds, and a dict of the others.

        Raises:
            FileNotFoundError: no such save.
            ValueError: a save of another game or number of worlds, without worlds or one of the others, or damaged.
        """
        number = self._found(number)
        save = self.folder / str(number)
        check_others(others)
        self._check_whole(number)
        if missing := sorted(name for name in others if not (save / name).is_dir()):
            raise ValueError(f"others: got {missing}, which are not in save {number} of {self.folder}; takes what is")
        trees, resized = boxed(others), False
        if worlds is not None:
            _check_worlds(worlds)
            if not (save / STATES).is_dir():
                raise ValueError(f"worlds: got some, and save {number} of {self.folder} has none; takes None")
            wanted, saved = self._arrays(worlds, number)
            resized = check_bool("resize", resize) and saved["step"][0] != worlds.n_worlds
            if mismatch := self._mismatch(wanted, saved, worlds, number, resized):
                raise ValueError(f"worlds: {mismatch}")
            trees[STATES] = {
                name: np.empty(saved[name], x.dtype) if resized else _target(worlds, x) for name, x in wanted.items()
            }
        for name in others:
            self._check_shapes(name, trees[name], number)
        if not trees:
            raise ValueError("others: got nothing to read; takes worlds, the names of other trees, or both")
        args = self._orbax.args
        asked = args.Composite(**{name: args.StandardRestore(tree) for name, tree in trees.items()})
        found = self._read(number, lambda: self._manager.restore(number, args=asked))
        states = None
        if worlds is not None:
            arrays = _resized(worlds, found[STATES]) if resized else found[STATES]
            states = _states_of(worlds, arrays)
        return states, {name: unboxed(found[name], tree) for name, tree in others.items()}

    def fits(self, worlds: Worlds | None = None, number: int | None = None, **others: Any) -> bool:
        """Whether a save has what `restore` would be asked for: these worlds, and trees of these shapes.

        Whether its arrays are as they were written is for `restore` to find out.

        Args:
            worlds: worlds; None asks of the others alone.
            number: number of the save; None asks of the latest.
            others: trees by the names of the save's other items.

        Returns:
            False also where the save has no worlds, or no item of a name.

        Raises:
            FileNotFoundError: no such save.
            ValueError: a save whose shapes cannot be read, a reserved name, or what is no array.
        """
        number = self._found(number)
        save = self.folder / str(number)
        check_others(others)
        if worlds is not None:
            if not (save / STATES).is_dir():
                return False
            wanted, saved = self._arrays(_check_worlds(worlds), number)
            if self._mismatch(wanted, saved, worlds, number, resized=False):
                return False
        return all(
            (save / name).is_dir() and self._difference(name, tree, number) is None
            for name, tree in boxed(others).items()
        )

    def _found(self, number: int | None) -> int:
        """Returns the number of a save, the latest if None.

        Raises:
            FileNotFoundError: no such save.
        """
        number = self.latest if number is None else number
        if number is None or number not in self._manager.all_steps():
            saved = sorted(self._manager.all_steps())
            has = f"has the saves {saved}" if saved else "has no saves yet"
            raise FileNotFoundError(f"number: got {number}, and {self.folder} {has}")
        return number

    def _sums(self, number: int) -> Path:
        """The file of the checksums of a save."""
        return self.folder / f".{number}.sums"

    def _check_whole(self, number: int) -> None:
        """Compares a save with its checksums: of damaged files Orbax logs hundreds of lines, from several threads.

        Raises:
            ValueError: a file that is not as it was written.
        """
        file, written = self._sums(number), None
        if not file.exists():
            return  # A save of an earlier version.
        with suppress(OSError, ValueError):
            written = json.loads(file.read_text())
        if not isinstance(written, dict):
            raise self._damaged(number, f"{file.name} is not as it was written")
        found = checksums(self.folder / str(number))
        if changed := sorted(name for name in {*written, *found} if written.get(name) != found.get(name)):
            raise self._damaged(number, f"{changed[0]} is not as it was written")

    def _damaged(self, number: int, reason: str) -> ValueError:
        others = sorted({*self._manager.all_steps()} - {number})
        takes = f"takes another save, of {others}" if others else "takes another folder: there is no other save in it"
        return ValueError(f"number: got {number} of {self.folder}, which is damaged ({reason}); {takes}")

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
        raise self._damaged(number, reason)

    def _check_shapes(self, name: str, tree: Any, number: int) -> None:
        """Refuses a tree whose arrays the save has not, or of other shapes or kinds of numbers."""
        if found := self._difference(name, tree, number):
            at, here, there = found
            inside = at.removeprefix(BOX).removeprefix(".")
            raise ValueError(
                f"others: got {name!r} with {f'{inside} of ' if inside else ''}{here}, and save {number} of "
                f"{self.folder} has {there}; takes a tree like the one that was saved"
            )

    def _difference(self, name: str, tree: Any, number: int) -> tuple[str, str, str] | None:
        """Returns the first array that differs: its name, its shape or numbers in the tree, and those in the save."""
        item = self.folder / str(number) / name
        saved, wanted = (
            {name_of(path): x for path, x in jax.tree.leaves_with_path(of)}
            for of in (self._read(number, lambda: self._metadata(item)), tree)
        )
        for at in (*wanted, *saved):
            here, there = (str(_shape(arrays[at])) if at in arrays else "none" for arrays in (wanted, saved))
            if here != there:
                return at, f"shape {here}", there
            here, there = (_numbers(arrays[at]) for arrays in (wanted, saved))
            if here and there and here != there:
                return at, here, there
        return None

    def _arrays(self, worlds: Worlds, number: int) -> tuple[dict[str, Any], dict[str, tuple[int, ...]]]:
        """Returns the arrays of worlds, and the shapes of those in a save, by name."""
        wanted = named(jax.eval_shape(keyless, worlds.states_shape.replace(recent=())))
        metadata = self._read(number, lambda: self._metadata(self.folder / str(number) / STATES))
        return wanted, {name: tuple(x.shape) for name, x in metadata.items()}

    def _mismatch(
        self, wanted: dict[str, Any], saved: dict[str, tuple[int, ...]], worlds: Worlds, number: int, resized: bool
    ) -> str:
        """Returns why worlds are not those of a save: another game, or other names and shapes; empty if they are.

        Of resized worlds the first axis may be another.
        """
        was, now = self.about(number), about_worlds(worlds)
        if was and (other := difference(was, now, wrappers=False)):
            return (
                f"{self.folder} has worlds of another environment, {other}; takes worlds of the same, or None for what "
                "else was saved"
            )
        if not resized and saved["step"][0] != worlds.n_worlds:
            return (
                f"got {worlds.n_worlds}, and {self.folder} has {saved['step'][0]}; takes as many as were saved, or "
                "resize=True"
            )
        if (was.get("engine") == "c") != (now["engine"] == "c") and set(saved) != set(wanted):
            return (
                f"got those of the engine {now['engine']!r}, and {self.folder} has those of {was.get('engine')!r}; "
                "takes the engine of the save, or None for what else was saved"
            )
        for name, x in wanted.items():
            if name not in saved or saved[name][1:] != x.shape[1:]:
                return (
                    f"{self.folder} has {name} of shape {saved.get(name)}, these worlds {x.shape}; takes worlds of the "
                    "same environment and engine as were saved"
                )
        if extra := sorted(set(saved) - set(wanted)):
            return f"{self.folder} also has {', '.join(extra)}; takes the environment of the save"
        return ""


def _check_worlds(worlds: Any) -> Worlds:
    if not isinstance(worlds, Worlds):
        raise ValueError(f"worlds: got {described(worlds)}; takes maax.Worlds(env, n_worlds)")
    return worlds


def _states_of(worlds: Worlds, arrays: dict[str, Any]) -> WorldsState:
    """Returns states on the worlds' devices of arrays by name, on the host or on the devices."""

    def leaf(path: Any, x: Any) -> Any:
        saved = arrays.get(name_of(path))
        if not isinstance(saved, jax.Array):
            saved = worlds.shards.put(np.empty(x.shape, x.dtype) if saved is None else saved)
        return as_key(saved, x)

    return worlds.remembering(jax.tree.map_with_path(leaf, worlds.states_shape.replace(recent=())))


def _resized(worlds: Worlds, saved: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns arrays for as many worlds as there are: the first of those saved, and new ones after them.

    Raises:
        ValueError: several processes, of which none has all worlds.
    """
    if jax.process_count() > 1:
        raise ValueError("resize: got True in several processes; takes it in one")
    n = worlds.n_worlds
    if len(saved["step"]) >= n:
        return {name: x[:n] for name, x in saved.items()}
    key = jax.random.fold_in(jax.random.wrap_key_data(jnp.asarray(saved["seed"][0])), len(saved["step"]))
    fresh = named(jax.device_get(worlds.flat(keyless(worlds.reset(key).replace(recent=())))))
    return {name: np.concatenate([x, fresh[name][len(x) :]]) for name, x in saved.items()}


@contextmanager
def _silence() -> Iterator[None]:
    """Silences Orbax's log: an item, unlike a whole save, has no metadata file of its own, and errors are raised.

    Orbax reads arrays side by side in asyncio, which logs the errors of all but the first on its own.
    """
    loggers = [logging.getLogger("absl"), logging.getLogger("asyncio")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _target(worlds: Worlds, x: Any) -> Any:
    """Returns where to read a leaf to: onto the devices if they share an array, else to the host."""
    if worlds.shards.method == "shard_map":
        return jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=NamedSharding(worlds.shards.mesh, P(AXIS)))
    return np.empty(x.shape, x.dtype)


def _shape(x: Any) -> tuple[int, ...]:
    return tuple(np.shape(x) if np.isscalar(x) else x.shape)


def _numbers(x: Any) -> str:
    """Returns what kind of numbers an array holds, "" where that is not known."""
    kinds = {"booleans": np.bool_, "whole numbers": np.integer, "floats": np.floating}
    dtype = getattr(x, "dtype", None)
    return "" if dtype is None else next((word for word, kind in kinds.items() if jnp.issubdtype(dtype, kind)), "")
