"""`maax-mjx info`: installed versions, the configs of environments, policies, and faults."""

from __future__ import annotations

import inspect
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from gymnasium import spaces

import maax_mjx as maax
from maax_mjx.cli.options import config_with, game_names, is_game, report
from maax_mjx.cli.saved import TAKES, env_of
from maax_mjx.common.checks import check_choice
from maax_mjx.common.runtime import cores
from maax_mjx.core.describe import Description, Row
from maax_mjx.parallel.recording import read
from maax_mjx.physics import best_impl, check_impl, impls
from maax_mjx.tasks import check_game
from maax_mjx.tasks.published import as_published
from maax_mjx.training.config import GROUPS, PRESETS
from maax_mjx.training.evaluate import player_of
from maax_mjx.training.shipped import file_of, policies
from maax_mjx.viewer.gl import backends

PACKAGES = (
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "warp-lang",
    "flax",
    "numpy",
    "gymnasium",
    "orbax-checkpoint",
    "viser",
    "av",
)


@dataclass
class Info:
    """Shows what is installed, or all about an environment, a policy, a preset of training, or a fault.

    A policy by its name, quadrant/forts, its file or the folder of its run; a preset of `maax-mjx train`: gpu, laptop
    or baker; a file of keep_faults, whose last step is made again.
    """

    env: tyro.conf.Positional[game_names()] = ""  # type: ignore[valid-type]
    """A game (or one in a file, my_game.py:football), policy, preset or kept fault; without, what is installed."""
    json: bool = False
    """Whether to print the result as JSON."""


def info(args: Info, overrides: Mapping[str, str]) -> None:
    """Runs the command.

    Raises:
        ValueError: an unknown environment.
    """
    kinds = {
        "file of a fault": (is_of_faults, lambda word: of_fault(Path(word))),
        "policy": (is_of_policy, of_policy),
        "preset": (PRESETS.__contains__, of_preset),
    }
    found = next(((kind, read) for kind, (is_one, read) in kinds.items() if args.env and is_one(args.env)), None)
    if found is None:
        result = of_env(args.env, overrides) if args.env else of_installation()
    elif overrides:
        raise ValueError(f"env: got {sorted(overrides)} for the {found[0]} {args.env}; takes them for a game")
    else:
        result = found[1](args.env)
    report(result, args.json, "\n".join(_lines(result)))


def is_of_faults(word: str) -> bool:
    """Whether a word is a file, one of keep_faults, and no environment."""
    return word.endswith((".npz", ".xml"))


def of_fault(path: Path) -> dict[str, Any]:
    """Collects where and when a world had a fault, and what a diagnosis of its last step finds.

    Args:
        path: a file of `Worlds(..., keep_faults=folder)`.

    Raises:
        ValueError: another file, or an engine that cannot be used here.
    """
    meta, _ = read(path, TAKES)
    if "fault" not in meta:
        raise ValueError(f"file: got {path}, which has a rollout without faults; takes a file of keep_faults")
    # The engine of the fault, where it runs; another one may not do it again.
    here = meta["fault"]["engine"] if _engine(meta["fault"]["engine"]).startswith("works") else "auto"
    fault = maax.load_fault(path, env_of(path, here))
    found = fault.diagnose()
    return {
        "file": str(path),
        "game": str(fault.env.made_from),
        **{name: str(value) for name, value in fault.about.items()},
        "frames": str(len(fault.recording.states.step)),
        "fault again": "yes" if found.fault else f"no, on {found.engine}",
        "about": str(found),
    }


def check_named(word: str) -> None:
    """Refuses a word that names nothing that the command shows.

    Raises:
        ValueError: another word; the message suggests the nearest environments or policies.
    """
    if is_of_faults(word) or is_of_policy(word) or word in PRESETS:
        return
    if not is_game(word) and not word.endswith(".py"):
        # Names of policies have a slash, as paths have.
        check_choice("env", word, policies() if "/" in word else {*maax.tasks(), *PRESETS, *policies()})
    check_game("env", word)


def is_of_policy(word: str) -> bool:
    """Whether a word is a policy's name, its file or the folder of its run, and no environment."""
    return word not in maax.tasks() and not word.endswith(".py") and file_of(Path(word.partition("@")[0])).exists()


def of_policy(word: str) -> dict[str, Any]:
    """Collects which game a policy plays, how long it was trained, and its networks.

    Args:
        word: its name, its file, or the folder of its run, as `player_of` takes them.

    Raises:
        ValueError: something else.
    """
    policy: Any = player_of("env", word)
    network, made = policy.network, policy.game or {"game": "one's own", "config": {}}
    return {
        "policy": word,
        "game": made["game"],
        "fields": made["config"],
        "teams": {name: f"{len(slots)} agents" for name, slots in network.teams},
        "env steps of its last run": f"{policy.steps:,}",
        "parameters": f"{sum(np.size(x) for x in jax.tree.leaves(policy.params)):,}",
        "networks": asdict(network.net),
    }


def of_preset(name: str) -> dict[str, Any]:
    """Collects the settings of a preset of training, by the names that options and overrides have, and what they mean.

    Args:
        name: its name.
    """
    config = PRESETS[name]
    settings = _fields(config)
    settings |= {f"env.{field}": value for field, value in settings.pop("env").items()}
    kinds = (type(part) for part in (config, *(getattr(config, group) for group in GROUPS)))
    return {
        "preset": name,
        "settings": settings,
        "about": "\n\n".join(inspect.cleandoc(kind.__doc__ or "") for kind in kinds),
    }


def of_installation() -> dict[str, Any]:
    """Collects versions, devices, usable engines, the engine that "auto" means, and the OpenGL library that works."""
    return {
        "maax_mjx": maax.__version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "devices": [str(device.device_kind) for device in jax.devices()],
        "cpus": cores(),
        "engines": {impl: _engine(impl) for impl in impls() if impl != "auto"},
        "auto": best_impl(),
        "opengl": backends(),
        "compiled programs": getattr(jax.config, "jax_compilation_cache_dir", None) or "not kept",
        "environments": maax.tasks(),
    }


def of_env(name: str, overrides: Mapping[str, str]) -> dict[str, Any]:
    """Collects an environment's config fields, teams, spaces and observations, and what it is.

    Args:
        name: name of the environment.
        overrides: values of its config's fields, as texts.
    """
    config = config_with(name, "auto", overrides)
    env = maax.make(name, config)
    return {
        "env": name,
        "fields": _fields(as_published(config)),
        "teams": {team.name: ", ".join(team.agents) for team in env.teams.values()},
        "action space": _space(env.action_space),
        "observation space": _space(env.observation_space),
        "observations": [row._asdict() for row in env.describe()],
        "about": _explained(type(config)),
    }


def _explained(config: type) -> str:
    """Returns what a config says of itself, and where the fields that it has from others are explained."""
    about = inspect.cleandoc(vars(config).get("__doc__") or "")
    if config is maax.WorldConfig or not issubclass(config, maax.WorldConfig):
        return about
    return f"{about}\n\nFields that are not explained here are those of all worlds: help(maax.WorldConfig) in Python."


def _space(space: spaces.Dict) -> dict[str, str]:
    return {name: str(part) for name, part in space.items()}


def _fields(config: Any, prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for f in fields(config):
        value = getattr(config, f.name)
        if is_dataclass(value):
            found |= _fields(value, f"{prefix}{f.name}.")
        else:
            found[prefix + f.name] = value.__name__ if callable(value) else value
    return found


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _engine(impl: str) -> str:
    try:
        check_impl(impl)
    except maax.MissingLibraryError:  # Warp's alone: MJX comes with the package
        return 'not installed: pip install -e ".[cuda]" in a clone of maax_mjx brings it (NVIDIA GPUs)'
    platform_of = jax.default_backend()
    if impl == "c" and platform_of != "cpu":
        return "only with JAX_PLATFORMS=cpu in the environment"
    if impl == "warp" and platform_of not in ("gpu", "cuda"):
        return "works, slowly: there is no NVIDIA GPU"
    return "works"


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else repr(value)


def _lines(result: Mapping[str, Any]) -> list[str]:
    lines = []
    for name, value in result.items():
        if name == "observations":
            table = Description(Row(**row) for row in value)
            lines += [name, *(f"  {line}" for line in str(table).splitlines())]
        elif name == "about":
            lines += ["", *str(value).splitlines()]
        elif isinstance(value, Mapping):
            width = max([26, *map(len, value)])
            lines += [f"{name}", *(f"  {key:{width}} {_shown(text)}" for key, text in value.items())]
        elif isinstance(value, list):
            lines.append(f"{name:18} {', '.join(value)}")
        else:
            lines.append(f"{name:18} {value}")
    return lines
