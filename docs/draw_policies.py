"""Draws trained agents playing, as the films and pages of docs/emergence.md: python docs/draw_policies.py --help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import jax
import tyro
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx import training

SIZE = (720, 560)
"""Pixels, width and height."""
FPS = 15


@dataclass
class Config:
    """Options.

    Attributes:
        policy: which policies to draw, those of `training.policies()` by default.
        impl: the engine.
        seed: of the worlds and the actions.
        worlds: the first worlds of so many are shown; none is chosen by how its episode went.
        out: folder for the files, a film (.gif) and a page (.html) for each policy.
    """

    policy: tuple[str, ...] = training.policies()
    impl: str = "auto"
    seed: int = 0
    worlds: int = 4
    out: Path = Path(__file__).parent / "emergence"


def main(config: Config) -> None:
    """Plays an episode of every policy and draws it."""
    config.out.mkdir(parents=True, exist_ok=True)
    for name in tqdm(config.policy, unit="policy"):
        policy = training.Policy.load(name)
        env = policy.make_env(impl=config.impl)
        worlds = maax.Worlds(env, config.worlds)
        states = worlds.reset(jax.random.key(config.seed))
        # The last step of an episode is the first of the next one.
        _, recording = maax.record(worlds, states, policy, env.base.horizon - 1, show=list(range(config.worlds)))
        file = config.out / name.replace("/", "_")
        maax.video(env, recording, file.with_suffix(".gif"), size=SIZE, fps=FPS)
        maax.replay(env, recording, file.with_suffix(".html"))


if __name__ == "__main__":
    main(tyro.cli(Config))
