"""The folder of a run: what it trains, its metrics, saves, policies and curves.

Of several processes the first one writes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from functools import wraps
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar, cast

import jax
import numpy as np

from maax_mjx.common.checks import described
from maax_mjx.common.claim import Claim
from maax_mjx.common.whole import whole
from maax_mjx.parallel.processes import together
from maax_mjx.training.board import Board
from maax_mjx.training.config import TrainConfig
from maax_mjx.training.curves import draw_curves
from maax_mjx.training.policy import Policy

RUN, METRICS, POLICY, PAST, CURVES, SAVES, SMALL, BOARD = (
    "run.json", "metrics.jsonl", "policy", "past", "curves.png", "saves", "learner", "tensorboard"
)  # fmt: skip
Writes = TypeVar("Writes", bound=Callable[..., None])
LOCK = ".lock"
"""Held by the process that trains."""
PART = 12_000_000
"""Bytes of a file of a small save, at most, unless one array is larger."""


def by_the_first(method: Writes) -> Writes:
    """Makes a method do nothing in all processes but the first one."""

    @wraps(method)
    def written(*args: Any, **named: Any) -> None:
        if jax.process_index() == 0:
            method(*args, **named)

    return cast(Writes, written)


def is_run(folder: Any) -> bool:
    """Whether something is the folder of a run."""
    return isinstance(folder, str | Path) and (Path(folder) / RUN).exists()


class Folder:
    """The files of a run.

    Args:
        path: the folder, created if it does not exist.
        tensorboard: whether metrics are written for TensorBoard as well.

    Raises:
        ValueError: no path, one where no folder can be made, or a folder with other files and no run.
        MissingLibraryError: TensorBoard's files without the package that writes them.
    """

    def __init__(self, path: str | Path, tensorboard: bool = False):
        if not isinstance(path, str | Path):
            raise ValueError(f"folder: got {described(path)}; takes a path")
        self.path = Path(path).absolute()
        self._drawing: Thread | None = None
        self._claim = Claim(self.path / LOCK)
        self._board = Board(self.path / BOARD) if tensorboard and jax.process_index() == 0 else None
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"folder: got {path}, where no folder can be made ({error.strerror})") from None
        self.found = is_run(self.path)
        if not self.found and any(not x.name.startswith(".") for x in self.path.iterdir()):
            raise ValueError(f"folder: got {path}, which has other files; takes an empty one, a new one, or a run's")
        # Before the first process writes what the others look for.
        together("folder")

    @by_the_first
    def claim(self) -> None:
        """Keeps other processes from training here until `close`.

        Raises:
            ValueError: another process trains here now, or nothing can be written here.
        """
        try:
            free = self._claim.take()
        except OSError as error:
            raise ValueError(
                f"folder: got {self.path}, where nothing can be written ({error.strerror}); takes another folder "
                "(--out)"
            ) from None
        if not free:
            raise ValueError(
                f"folder: got {self.path}, where another process trains now; takes another folder (--out), or this one "
                "once that has ended"
            )

    def about(self) -> dict[str, Any]:
        """Reads what the run trains.

        Raises:
            ValueError: a damaged file.
        """
        try:
            return json.loads((self.path / RUN).read_text())
        except (OSError, json.JSONDecodeError) as error:
            raise ValueError(
                f"folder: got {self.path}, whose {RUN} cannot be read ({error}); takes another folder (--out)"
            ) from None

    @by_the_first
    def describe(self, about: Mapping[str, Any]) -> None:
        """Writes what the run trains."""
        with whole(self.path / RUN) as part:
            part.write_text(json.dumps(about, indent=1) + "\n")

    @by_the_first
    def go_on(self, game: Mapping[str, Any] | None, settings: Mapping[str, Any], change: Mapping[str, Any]) -> None:
        """Writes the game, with its engine, and the settings with which the run goes on, and lists the change."""
        about = self.about()
        self.describe(about | {"game": game, "settings": settings, "changes": [*about.get("changes", []), change]})

    @by_the_first
    def note(self, row: Mapping[str, Any]) -> None:
        """Appends a row to the metrics."""
        plain = {name: _plain(value) for name, value in row.items()}
        with (self.path / METRICS).open("a") as file:
            file.write(json.dumps(plain) + "\n")
        if self._board:
            self._board.add(plain)

    @by_the_first
    def draw(self, finished: bool = False) -> None:
        """Draws the curves of the metrics, beside the training; not while it still draws the last ones.

        Args:
            finished: whether to wait for them, since no other drawing follows.
        """
        if self._drawing is not None and (finished or not self._drawing.is_alive()):
            self._drawing.join()
            self._drawing = None
        if self._drawing is None:
            self._drawing = Thread(target=lambda: draw_curves(self.rows(), self.path / CURVES))
            self._drawing.start()
        if finished:
            self._drawing.join()

    def close(self) -> None:
        """Waits until everything is written, and lets other processes train here."""
        if self._board:
            self._board.close()
        self._claim.give_up()

    @by_the_first
    def keep(self, policy: Policy) -> None:
        """Writes the newest policy."""
        policy.save(self.path / POLICY)

    def rows(self) -> list[dict[str, Any]]:
        """Reads the metrics of all iterations; a line that was cut off is left out."""
        found = []
        for line in self._lines():
            try:
                found.append(json.loads(line))
            except json.JSONDecodeError:
                continue
        return found

    @by_the_first
    def forget(self, iteration: int) -> None:
        """Drops the metrics after an iteration, which a run that goes on from its save makes again."""
        kept = [row for row in self.rows() if row["iteration"] <= iteration]
        if self._board and kept:
            self._board.forget(kept[-1]["steps"])
        if len(kept) < len(self._lines()):
            with whole(self.path / METRICS) as part:
                part.write_text("".join(json.dumps(row) + "\n" for row in kept))

    def _lines(self) -> list[str]:
        file = self.path / METRICS
        return file.read_text().splitlines() if file.exists() else []

    @by_the_first
    def keep_past(self, policy: Policy) -> None:
        """Keeps a policy of now among the past ones."""
        (self.path / PAST).mkdir(exist_ok=True)
        policy.save(self.path / PAST / f"{policy.steps:015d}")

    def past(self) -> list[tuple[int, Path]]:
        """Steps and files of the past policies, the oldest first."""
        folder = self.path / PAST
        files = sorted(folder.iterdir()) if folder.is_dir() else []
        return [(int(file.name), file) for file in files if file.name.isdigit()]

    @property
    def has_no_save(self) -> bool:
        """Whether there is nothing that the run could go on from."""
        saves, small = self.path / SAVES, self.path / SMALL / "save.json"
        return not small.exists() and not (saves.is_dir() and any(x.name.isdigit() for x in saves.iterdir()))

    @by_the_first
    def save_small(self, tree: Any, about: Mapping[str, Any]) -> None:
        """Writes a save that travels: arrays in files of some megabytes.

        Args:
            tree: the arrays.
            about: numbers to go on with.
        """
        folder = self.path / SMALL
        folder.mkdir(exist_ok=True)
        names = []
        for i, part in enumerate(_parts(jax.device_get(tree))):
            # Files of different saves have different names: the list of them makes a save complete.
            names.append(f"{about['iteration']}-{i}.npz")
            with whole(folder / names[-1]) as path:
                np.savez(path, **part)  # type: ignore[arg-type]
        with whole(folder / "save.json") as path:
            path.write_text(json.dumps({**about, "files": names}))
        for old in folder.glob("*.npz"):
            if old.name not in names and not old.name.startswith("."):
                old.unlink()

    def load_small(self, like: Any) -> tuple[Any, dict[str, Any]] | None:
        """Reads the small save; None without.

        Args:
            like: a tree of the same structure and shapes.

        Raises:
            ValueError: a damaged save, or one of other shapes.
        """
        folder = self.path / SMALL
        if not (folder / "save.json").exists():
            return None
        try:
            about = json.loads((folder / "save.json").read_text())
            arrays: dict[str, np.ndarray] = {}
            for name in about["files"]:
                with np.load(folder / name, allow_pickle=False) as file:
                    arrays |= dict(file)
            found = []
            for path, x in jax.tree.leaves_with_path(like):
                array = arrays[jax.tree_util.keystr(path)]
                if array.shape != np.shape(x):
                    raise ValueError(f"{jax.tree_util.keystr(path)} has shape {array.shape}, not {np.shape(x)}")
                found.append(array)
        # Damaged bytes make NumPy, zipfile and JSON raise errors of a dozen kinds.
        except Exception as error:
            reason = str(error).partition(". ")[0]
            raise ValueError(
                f"folder: got {self.path}, whose {SMALL}/ cannot be read ({reason}); delete it, and the run goes on "
                f"from {SAVES}/"
            ) from None
        return jax.tree.unflatten(jax.tree.structure(like), found), about


def _parts(tree: Any) -> Iterator[dict[str, np.ndarray]]:
    part: dict[str, np.ndarray] = {}
    for path, x in jax.tree.leaves_with_path(tree):
        array = np.asarray(x)
        if part and sum(a.nbytes for a in part.values()) + array.nbytes > PART:
            yield part
            part = {}
        part[jax.tree_util.keystr(path)] = array
    yield part


def _plain(value: Any) -> Any:
    """A number with six digits, as JSON has it: NaN and infinities are None."""
    if isinstance(value, int | str | bool) or value is None:
        return value
    number = float(value)
    return float(f"{number:.6g}") if math.isfinite(number) else None


def settings_of(config: TrainConfig) -> dict[str, Any]:
    """Returns the settings as JSON has them."""
    return json.loads(json.dumps(asdict(config), default=str))
