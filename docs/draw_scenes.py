"""Draws scripted agents playing, as the gifs of docs/games.md: python docs/draw_scenes.py --help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import tyro
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.tasks.scenes import SCENES

SECONDS = 5
"""Longest gif; longer plays are shown faster."""
SIZE = (440, 360)
"""Pixels, width and height."""


@dataclass
class Config:
    """Options.

    Attributes:
        scene: which plays to draw.
        impl: the engine.
        seed: of the worlds.
        fps: frames per second.
        out: folder for the gifs, named after their scenes.
    """

    scene: tuple[str, ...] = tuple(SCENES)
    impl: str = "auto"
    seed: int = 0
    fps: int = 20
    out: Path = Path(__file__).parent / "results"


def main(config: Config) -> None:
    """Plays every scene and writes its gif."""
    config.out.mkdir(parents=True, exist_ok=True)
    for name in tqdm(config.scene, unit="scene"):
        scene = SCENES[name](config.impl)
        _, states = jax.device_get(jax.jit(scene.play)(jax.jit(scene.reset)(jax.random.key(config.seed))))
        ends = np.flatnonzero(states.terminated)
        n_steps = int(ends[0]) + 1 if ends.size else scene.n_steps
        states = jax.tree.map(lambda x, n=n_steps: x[:n], states)
        speed = max(1.0, n_steps * scene.env.base.dt / SECONDS)
        maax.video(scene.env, states, config.out / f"{name}.gif", size=SIZE, fps=config.fps, speed=speed)


if __name__ == "__main__":
    main(tyro.cli(Config))
