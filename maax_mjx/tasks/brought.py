"""Games that others bring: installed packages, by entry points, and Python files, as in "my_game.py:football"."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

GROUP = "maax_mjx.games"
"""Of the entry points: a game's name, and its function from a config to an environment."""
FILE = ".py:"
TAKES = 'takes a Python file and a game in it, such as "my_game.py:football"'


@lru_cache(maxsize=1)
def installed() -> Mapping[str, EntryPoint]:
    """Returns the entry points of installed packages by the names of their games."""
    return {point.name: point for point in entry_points(group=GROUP)}


def is_in_a_file(name: object) -> bool:
    """Whether a name is that of a game in a file."""
    return isinstance(name, str) and FILE in name


def short_name(name: str) -> str:
    """Returns a game's name without its file."""
    return name.rpartition(FILE)[2]


def is_same_game(name: str, other: str) -> bool:
    """Whether two names are of one game: the same, or of files of one name, which may lie in other folders by now."""
    if not (is_in_a_file(name) and is_in_a_file(other)):
        return name == other
    (path, _, short), (path_too, _, short_too) = name.rpartition(":"), other.rpartition(":")
    return short == short_too and Path(path).name == Path(path_too).name


def module_of(name: str) -> ModuleType:
    """Imports the file of a game, once in a process, as Python does with a script: its folder comes first on the path.

    Raises:
        ValueError: no such file, a file that cannot be imported, or one that is called like a module that is loaded.
    """
    path = Path(name.rpartition(":")[0]).resolve()
    if not path.is_file():
        raise ValueError(f"name: got {name!r}, and there is no file {path}; {TAKES}, from this folder")
    loaded = sys.modules.get(path.stem)
    if loaded is not None:
        if Path(getattr(loaded, "__file__", None) or "").resolve() != path:
            raise ValueError(f"name: got {name!r}, and another module is called {path.stem}; takes a file renamed")
        return loaded
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[path.stem] = module_from_spec(spec)
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[path.stem]
        if not isinstance(error, Exception):
            raise
        raise ValueError(
            f"name: got {name!r}, whose file cannot be imported ({type(error).__name__}: {error}); {TAKES}"
        ) from error
    return module


def config_class(build: Any) -> type | None:
    """Returns the class of config that a function makes an environment from, by its annotation; None for others."""
    if not callable(build) or isinstance(build, type):
        return None
    try:
        arguments, hints = list(signature(build).parameters), get_type_hints(build)
    # Whatever an annotation may raise, it names no class then.
    except Exception:
        return None
    found = hints.get(arguments[0]) if len(arguments) == 1 else None
    return found if isinstance(found, type) and is_dataclass(found) else None


def games_in(module: ModuleType) -> dict[str, tuple[Callable[..., Any], type]]:
    """Returns the functions of a module that make environments from a config, with the class of that."""
    own = {name: x for name, x in vars(module).items() if getattr(x, "__module__", None) == module.__name__}
    return {name: (x, found) for name, x in own.items() if (found := config_class(x)) is not None}
