"""Parts that the commands share: fields of an environment's config, results as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import maax_mjx as maax
from maax_mjx.common.annotated import Bounds
from maax_mjx.common.checks import LONG
from maax_mjx.common.options import number_of, value_of
from maax_mjx.common.recorded import flat, texts_of
from maax_mjx.common.whole import FOLDERS
from maax_mjx.core.env import Environment
from maax_mjx.tasks import is_in_a_file
from maax_mjx.tasks.brought import is_same_game
from maax_mjx.tasks.config import inner_config, recorded_plain, with_tuples
from maax_mjx.training.run import NotFiniteError
from maax_mjx.training.trained import TrainedPolicy

ENV = "--env."
MISTAKES = (ValueError, OSError, MemoryError, NotFiniteError, maax.MissingLibraryError)
Seed = Annotated[int, Bounds(0, LONG)]


def names(choices: Iterable[str]) -> Any:
    """Returns the type of an option that takes one of some names, which Tab completes."""
    return Literal[tuple(choices)]


def game_names() -> Any:
    """Returns the type of an option that takes a game: names, which Tab completes, or "my_game.py:football"."""
    return names(maax.tasks()) | str


def is_game(word: str) -> bool:
    """Whether a word names a game."""
    return word in maax.tasks() or is_in_a_file(word)


def check_words(argv: Sequence[str]) -> None:
    """Refuses empty values: an empty path would be the working directory.

    Raises:
        ValueError: an empty value; the message names its option.
    """
    for before, word in zip(["", *argv], argv, strict=False):
        name, equals, value = word.partition("=") if word.startswith("--") else (before, "", word)
        if not value and (equals or not word):
            raise ValueError(f"{name.removeprefix('--')}: got an empty value; takes one, or leave the option out")


def split_overrides(argv: list[str], prefix: str = ENV) -> tuple[list[str], dict[str, str]]:
    """Splits the arguments into those without `--env.FIELD VALUE`, and a dict of these.

    A value ends at the next option or at the name of an environment; several words are joined by commas, so that
    `--env.n_boxes 2 6` is `--env.n_boxes 2,6`.

    Args:
        argv: the arguments.
        prefix: what the fields' names begin with.

    Raises:
        ValueError: a field without a value.
    """
    rest: list[str] = []
    found: dict[str, list[str]] = {}
    name, open_ended = "", False
    for word in argv:
        if word.startswith(prefix):
            name, equals, value = word.removeprefix(prefix).partition("=")
            name, open_ended = name.replace("-", "_"), not equals
            found[name] = [value] if equals else []
        elif open_ended and not word.startswith("--") and not (found[name] and is_game(word)):
            found[name].append(word)
        else:
            open_ended = False
            rest.append(word)
    for name, words in found.items():
        if not any(words):
            raise ValueError(f"{prefix}{name}: got no value; takes one, such as 3, or 2,6 for a range")
    return rest, {name: ",".join(words) for name, words in found.items()}


def make_env(name: str, impl: str, overrides: Mapping[str, str]) -> Environment:
    """Makes an environment by name, with fields of its config given as texts; see `config_with`.

    Raises:
        ValueError: a name or field that `maax.make` refuses.
    """
    return maax.make(name, config_with(name, impl, overrides))


def config_with(name: str, impl: str, overrides: Mapping[str, str]) -> Any:
    """Makes the config of an environment, with fields that are given as texts; see `values_of`.

    Raises:
        ValueError: an unknown field, or two engines.
    """
    return config_on(name, impl, values_of(name, overrides))


def config_on(name: str, impl: str, fields: Mapping[str, Any]) -> Any:
    """Makes the config of an environment with the engine of --impl.

    Raises:
        ValueError: an unknown field, or two engines.
    """
    # A game's config may leave the engine to the game.
    if impl != "auto" or hasattr(maax.config_of(name), "impl"):
        fields = on_engine(impl, fields)
    return maax.config_of(name, **fields)


def on_engine(impl: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the fields of a config with the engine of --impl.

    Raises:
        ValueError: they name another one.
    """
    if impl not in ("auto", fields.get("impl", impl)):
        raise ValueError(f"impl: got --impl {impl} and {ENV}impl {fields['impl']}; takes one of them")
    return {"impl": impl, **fields}


def values_of(name: str, overrides: Mapping[str, str]) -> dict[str, Any]:
    """Returns the fields of an environment's config that are given as texts.

    True means the defaults of a field that is itself a config, such as `--env.grab True`, and False that it is None.

    Raises:
        ValueError: an unknown environment.
    """
    config = type(maax.config_of(name))
    values = {field: value_of(text) for field, text in overrides.items()}
    for field, value in values.items():
        if isinstance(value, bool) and (inner := inner_config(config, field)):
            values[field] = inner() if value else None
    # Whole configs first, so that their own fields can be given in any order.
    return dict(sorted(values.items(), key=lambda item: "." in item[0]))


def as_learnt(game: str, policy: TrainedPolicy) -> dict[str, str]:
    """Returns the fields of the config of the game that a policy learnt, as texts; see `recorded_plain`.

    Raises:
        ValueError: a policy of another game.
    """
    learnt = policy.game or {"game": "an environment of one's own", "config": {}}
    if not is_same_game(learnt["game"], game):
        raise ValueError(f"policy: got one of {learnt['game']}, to play {game}; takes one of the same game")
    config = maax.config_of(game)
    fields = recorded_plain(config, learnt)
    # Of a group that is None by default its own fields alone would say nothing.
    groups = {name: "True" for name, value in fields.items() if inner_config(type(config), name) and value}
    return groups | texts_of({name: with_tuples(value) for name, value in flat(fields).items()})


def report(result: Mapping[str, Any], as_json: bool, lines: str) -> None:
    """Prints a command's result: JSON for machines, or lines for people."""
    print(json.dumps(result, indent=1) if as_json else lines, flush=True)


def check_out(path: Path, endings: Sequence[str]) -> None:
    """Refuses a path that no file of some kinds can be written to.

    Raises:
        ValueError: another ending, or a folder.
    """
    folder = ", which is a folder" if path.is_dir() else ""
    if folder or path.suffix.lower() not in endings:
        raise ValueError(f"out: got {path}{folder}; takes a file that ends in one of {', '.join(endings)}")


def make_folder(path: Path) -> None:
    """Makes a folder for files, and those above it.

    Raises:
        ValueError: the folder cannot be made.
    """
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        FOLDERS[:0] = new
    except OSError as error:
        raise ValueError(f"out: got {path}, where no folder can be made ({error.strerror}); takes another") from None


def apart(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Splits "2,6" among the values of an option at its comma, as fields of a game's config are written."""
    words = [part for value in values for part in str(value).split(",")]
    return tuple(number_of(word, int) for word in words)


def count_of(name: str, values: tuple[int, ...]) -> int | tuple[int, int]:
    """Returns a number, or a range of two.

    Raises:
        ValueError: more or fewer numbers.
    """
    if len(values) == 1:
        return values[0]
    if len(values) == 2:
        return values[0], values[1]
    raise ValueError(f"{name}: got {values}; takes one number, or LOW HIGH")
