"""Files of rollouts and faults, with the environment that they are of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx.cli.options import config_on, make_env
from maax_mjx.core.env import Environment, Made
from maax_mjx.core.identity import about_game
from maax_mjx.parallel.recording import Recording, filled, read, strip, write
from maax_mjx.tasks.config import recorded_fields

TAKES = "takes a rollout.npz of maax-mjx rollout, or a file of keep_faults"


def save(path: Path, env: str, overrides: Mapping[str, str], recording: Recording, made: Made | None = None) -> None:
    """Writes a recording completely or not at all.

    Args:
        path: the .npz file.
        env: the environment's name.
        overrides: values of its config's fields, as texts.
        recording: the recording.
        made: what the environment was made from, whose defaults are kept as well.
    """
    fields = {name: value for name, value in overrides.items() if name != "impl"}  # pictures are the same on any
    about = {"about": about_game(made)} if made else {}
    write(path, {"maax_mjx": maax.__version__, "env": env, "overrides": fields} | about, recording)


def load(path: Path) -> tuple[Environment, Recording]:
    """Loads the recording and its environment, on the C engine, or on MJX-JAX if there is an accelerator.

    Raises:
        ValueError: a file that `save` did not write, or one of another version.
    """
    meta, arrays = read(path, TAKES)
    # Pictures do not depend on the engine.
    env = env_of(path, "c" if jax.default_backend() == "cpu" else "jax")
    template = Recording(strip(env.state_shape), jax.ShapeDtypeStruct((env.base.n_agents,), jnp.float32))
    return env, filled(path, meta, arrays, template, leading=2)


def env_of(path: Path, impl: str) -> Environment:
    """Makes the environment that a file is of, on an engine.

    Raises:
        ValueError: a file of something else, or of an environment that `maax.make` did not make.
    """
    meta, _ = read(path, TAKES)
    if not meta["env"]:
        raise ValueError(
            f"file: got {path}, of an environment that maax.make did not make; takes one of a registered game: in "
            "Python, maax.load_fault(path, env) takes any environment"
        )
    if "about" not in meta:  # as in files of before there were defaults
        return make_env(meta["env"], impl, meta["overrides"])
    fields = recorded_fields(maax.config_of(meta["env"]), meta["about"])
    fields.pop("impl", None)
    return maax.make(meta["env"], config_on(meta["env"], impl, fields))
