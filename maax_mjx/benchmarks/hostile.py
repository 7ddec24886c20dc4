"""Full force, held, against the physics: `python -m maax_mjx.benchmarks.hostile --help`.

Bang-bang actions held for 1 to 1,000 steps push everything into walls and corners, where solvers fail. Random actions
redrawn every step average to no force and hide it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import tyro
from flax import struct
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.parallel import WorldsState

CHUNK = 50


class Seen(struct.PyTreeNode):
    """What a user saw during a rollout.

    Attributes:
        finite: () bool, no number of observations, rewards or physics was NaN or infinite.
        inside: () bool, no agent's centre was ever left further outside the arena than a fault's margin.
        truncating: () bool, every fault truncated its world.
    """

    finite: jax.Array
    inside: jax.Array
    truncating: jax.Array

    @classmethod
    def nothing(cls) -> Seen:
        """Before the first step."""
        return cls(*(jnp.ones((), bool) for _ in range(3)))

    def and_(self, states: WorldsState, agents: jax.Array, floor_size: float) -> Seen:
        """After a step more; `agents` are (n_worlds, n_agents, 3) positions."""
        leaves = jax.tree.leaves((states.obs, states.final_obs, states.reward, states.data.replace(engine=())))
        floats = [x for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)]
        middle = floor_size / 2
        return Seen(
            finite=self.finite & jnp.stack([jnp.isfinite(x).all() for x in floats]).all(),
            inside=self.inside & (jnp.abs(agents[..., :2] - middle) < middle + 0.31).all(),
            truncating=self.truncating & (states.metrics["physics_fault"] <= states.truncated).all(),
        )


def player(worlds: maax.Worlds) -> Callable[[WorldsState, Seen, jax.Array, int], tuple[WorldsState, Seen]]:
    """A compiled rollout `(states, seen, steps, held)` of bang-bang actions held for a traced number of steps."""
    base = worlds.env.base

    def play(states: WorldsState, seen: Seen, steps: jax.Array, held: int) -> tuple[WorldsState, Seen]:
        def step(carry: tuple[WorldsState, Seen], t: jax.Array) -> tuple[tuple[WorldsState, Seen], None]:
            states, seen = carry
            key = jax.random.fold_in(jax.random.key(0), t // held)
            move = jnp.where(jax.random.bernoulli(key, shape=(worlds.n_worlds, base.n_agents, 3)), 1.0, -1.0)
            states = worlds.step_fn(states, {"move": move})
            return (states, seen.and_(states, states.data.xpos[:, base.agents.body_ids], base.floor_size)), None

        return jax.lax.scan(step, (states, seen), steps)[0]

    return jax.jit(play, donate_argnums=0)


@dataclass
class Config:
    """Options.

    Attributes:
        impl: engines.
        worlds: batch size.
        steps: env steps of every rollout.
        held: for how many steps an action is held.
        gravity: m/s^2.
        contacts_per_world: room for contact points; as many as the environment takes by itself if left out.
        out: JSON file to write; nothing is written without one.
    """

    impl: tuple[str, ...] = ("c",)
    worlds: int = 1000
    steps: int = 1000
    held: tuple[int, ...] = (1, 20, 100, 1000)
    gravity: tuple[float, ...] = (-9.81, -50.0)
    contacts_per_world: int | None = None
    out: Path | None = None


@dataclass
class Row:
    """One rollout; counts are over all worlds and steps."""

    impl: str
    worlds: int
    steps: int
    held: int
    gravity: float
    contacts_per_world: int
    finite: bool
    inside: bool
    faults_truncate: bool
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int
    env_steps_per_s: float


def main(config: Config) -> None:
    """Plays every combination, prints what was seen, and writes the JSON after each."""
    if config.steps < CHUNK or config.steps % CHUNK:
        raise ValueError(f"steps: got {config.steps}; takes a multiple of {CHUNK}")
    rows: list[Row] = []
    for impl in config.impl:
        for gravity in config.gravity:
            params = maax.WorldParams(gravity=gravity)
            env = maax.make(
                "standard", impl=impl, world_params=params, contacts_per_world=config.contacts_per_world
            ).base
            worlds = maax.Worlds(env, config.worlds)
            play = player(worlds)
            chunks = jnp.arange(config.steps).reshape(-1, CHUNK)
            jax.block_until_ready(play(worlds.reset(jax.random.key(0)), Seen.nothing(), chunks[0], 1))
            for held in config.held:
                states, seen = worlds.reset(jax.random.key(0)), Seen.nothing()
                begun = time.perf_counter()
                for steps in tqdm(chunks, desc=f"{impl} g {gravity} held {held}", unit=f"{CHUNK} steps", leave=False):
                    states, seen = jax.block_until_ready(play(states, seen, steps, held))
                rate = config.worlds * chunks.size / (time.perf_counter() - begun)
                counts = states.totals()
                row = Row(
                    impl=impl,
                    worlds=config.worlds,
                    steps=chunks.size,
                    held=held,
                    gravity=gravity,
                    contacts_per_world=env.contacts_per_world,
                    finite=bool(seen.finite),
                    inside=bool(seen.inside),
                    faults_truncate=bool(seen.truncating),
                    physics_faults=counts["physics_fault"],
                    contact_overflows=counts["contact_overflow"],
                    layouts_invalid=counts["layout_invalid"],
                    env_steps_per_s=round(rate),
                )
                rows.append(row)
                print(row, flush=True)
                record.write(config.out, config, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
