"""One team of a game as an environment of MuJoCo Playground's."""

from __future__ import annotations

from typing import Any

import mujoco

from maax_mjx.adapters.team import OneTeam
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.core.env import Environment
from maax_mjx.viewer import render


def playground(env: Environment, team: str | None = None, policy: Any = None) -> Any:
    """Makes a `mujoco_playground.MjxEnv` of one team of a game, as one agent with vectors of numbers.

    Observations, actions and rewards are those of `adapters.brax`. Playground's wrapper begins every episode of a world
    in the layout of the world's first reset, or with `full_reset=True` in a new one, which is drawn at every step, used
    or not. Give it `episode_length=env.base.horizon`: the horizon is its to keep. `state.data.state` is the world as
    maax_mjx has it; `mj_model` is the model that all worlds share, which is not what a single one looks like, and
    `maax.to_mjcf` writes one.

    Args:
        env: an environment whose agents observe for themselves.
        team: name of the team; None is all agents.
        policy: who plays the others; see `gymnasium_vector`.

    Raises:
        MissingLibraryError: without MuJoCo Playground, the extra "playground".
        ValueError: see `gymnasium_vector`.
    """
    try:
        from ml_collections import config_dict
        from mujoco import mjx
        from mujoco_playground import MjxEnv
        from mujoco_playground import State as PlaygroundState
    except ImportError as error:
        raise MissingLibraryError(f"playground: needs MuJoCo Playground; {brought_by('playground')}") from error
    of = OneTeam(env, team, policy)
    base = of.env.base

    class Game(of.as_env(MjxEnv, PlaygroundState, "data")):  # type: ignore[misc]
        """One team of a game of maax_mjx."""

        def __init__(self) -> None:
            times = config_dict.create(ctrl_dt=base.dt, sim_dt=base.world_params.timestep)
            super().__init__(times)

        @property
        def xml_path(self) -> str:
            # Its model is made by code.
            return ""

        @property
        def mj_model(self) -> mujoco.MjModel:
            return base.model

        @property
        def mjx_model(self) -> Any:
            return mjx.put_model(base.model)

        def render(self, trajectory: Any, height: int = 240, width: int = 320, **_: Any) -> Any:
            states = trajectory if isinstance(trajectory, list) else [trajectory]
            images = [render(of.env, one.data.state, size=(width, height)) for one in states]
            return images if isinstance(trajectory, list) else images[0]

    return Game()
