"""How much an env step costs over a bare engine step: `python -m maax_mjx.benchmarks.step --help`.

Both step the same model in the same batch, in turns within one run, under the same actions. Bare is the engine alone:
`mujoco.batch.Batch.step` for `c`, a jitted, vmapped `mjx.step` that carries its mjx.Data for `jax`. An env step adds
the overlay, fault containment, observations and automatic resets with new layouts.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from mujoco import mjx
from mujoco.batch import Batch
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.base import Base
from maax_mjx.parallel import WorldsState
from maax_mjx.physics.c_engine import CEngine

ROUNDS = 8
PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "flax", "numpy")


@dataclass
class Config:
    """Options.

    Attributes:
        impl: engines to time.
        worlds: batch sizes.
        steps: env steps per measurement, in turns of an eighth each.
        horizon: env steps per episode; below `steps`, so that every world is reset.
        held: for how many steps an action is held; 1 redraws it every step.
        out: JSON file to write; nothing is written without one.
    """

    impl: tuple[str, ...] = ("c", "jax")
    worlds: tuple[int, ...] = (256,)
    steps: int = 1200
    horizon: int = 1000
    held: tuple[int, ...] = (1, 20)
    out: Path | None = None


@dataclass
class Row:
    """One measurement: env-steps and bare engine steps per second, all worlds added, one physics step each."""

    impl: str
    worlds: int
    episodes: str
    held: int
    env_steps_per_s: float
    bare_steps_per_s: float
    ratio: float
    episodes_ended: int
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int


def draw_actions(env: Base, n_worlds: int, steps: int, held: int) -> list[dict[str, jax.Array]]:
    """Full-range actions for every step: bang-bang where held, uniform where redrawn."""
    rng = np.random.default_rng(0)
    shape = (n_worlds, env.n_agents, 3)
    distinct = []
    for _ in range(min(-(-steps // held), 64)):
        move = rng.choice([-1.0, 1.0], shape) if held > 1 else rng.uniform(-1, 1, shape)
        distinct.append({"move": jnp.asarray(move, jnp.float32)})
    return [distinct[(i // held) % len(distinct)] for i in range(steps)]


def bare_stepper(env: Base, states: WorldsState) -> Callable[[dict[str, jax.Array]], Any]:
    """A function that steps the bare engine from these states and returns what to wait for."""
    n_worlds = states.step.shape[0]
    if isinstance(env.engine, CEngine):
        batch = Batch(env.engine.c_model, n_worlds)
        for name, ids in env.overlay.items():
            batch.expand(name)[:, ids] = states.world.fields[name]
        batch.qpos[...] = np.asarray(states.data.qpos)

        def step_c(action: dict[str, jax.Array]) -> None:
            batch.ctrl[:, ctrl_ids] = np.asarray(action["move"]).reshape(n_worlds, -1)
            batch.step()

        ctrl_ids = env.agents.ctrl_ids.reshape(-1)
        return step_c

    model = env.engine.mjx
    ids = env.agents.ctrl_ids.reshape(-1)

    def step_one(world: Any, data: mjx.Data, move: jax.Array) -> mjx.Data:
        return mjx.step(model.overlay(world), data.replace(ctrl=data.ctrl.at[ids].set(move.reshape(-1))))

    jitted = jax.jit(jax.vmap(step_one), donate_argnums=1)
    world = jax.tree.map(jnp.copy, states.world)
    held = {"data": jax.jit(jax.vmap(model.data))(jax.tree.map(jnp.copy, states.data))}

    def step_mjx(action: dict[str, jax.Array]) -> jax.Array:
        held["data"] = jitted(world, held["data"], action["move"])
        return held["data"].qpos

    return step_mjx


def measure(impl: str, n_worlds: int, stagger: bool, held: int, config: Config) -> Row:
    """Times env steps and bare steps in turns."""
    env = maax.make("standard", impl=impl, horizon=config.horizon)
    assert isinstance(env, Base)
    worlds = maax.Worlds(env, n_worlds)
    states = worlds.reset(jax.random.key(0), stagger=stagger)
    bare = bare_stepper(env, states)
    actions = draw_actions(env, n_worlds, config.steps, held)
    jax.block_until_ready(bare(actions[0]))
    states = jax.block_until_ready(worlds.step(states, actions[0]))
    spent = {"env": 0.0, "bare": 0.0}
    turns = np.array_split(np.arange(config.steps), ROUNDS)
    label = f"{impl} {n_worlds} {'staggered' if stagger else 'lockstep'} held {held}"
    for turn in tqdm(turns, desc=label, unit="turn", leave=False):
        start = time.perf_counter()
        for i in turn:
            states = worlds.step(states, actions[i])
        jax.block_until_ready(states)
        middle = time.perf_counter()
        last = None
        for i in turn:
            last = bare(actions[i])
        jax.block_until_ready(last)
        spent["env"] += middle - start
        spent["bare"] += time.perf_counter() - middle
    counts = {name: int(value.sum()) for name, value in states.counts.items()}
    total = n_worlds * config.steps
    return Row(
        impl=impl,
        worlds=n_worlds,
        episodes="staggered" if stagger else "lockstep",
        held=held,
        env_steps_per_s=total / spent["env"],
        bare_steps_per_s=total / spent["bare"],
        ratio=spent["bare"] / spent["env"],
        episodes_ended=counts["episodes"],
        physics_faults=counts["physics_fault"],
        contact_overflows=counts["contact_overflow"],
        layouts_invalid=counts["layout_invalid"],
    )


def conditions() -> dict[str, Any]:
    """Versions, devices and date, for the record."""
    return {
        "date": date.today().isoformat(),
        "python": platform.python_version(),
        "devices": [d.device_kind for d in jax.devices()],
        "cpus": os.cpu_count(),
        "packages": {name: version(name) for name in PACKAGES},
    }


def main(config: Config) -> None:
    """Runs all measurements, prints a table and writes the JSON after each, so that an interruption loses none."""
    rows: list[Row] = []
    print(f"{'impl':5} {'worlds':>7} {'episodes':>10} {'held':>5} {'env/s':>11} {'bare/s':>11} {'ratio':>6} faults")
    for impl in config.impl:
        for n_worlds in config.worlds:
            for held in config.held:
                for stagger in (False, True):
                    row = measure(impl, n_worlds, stagger, held, config)
                    rows.append(row)
                    print(
                        f"{row.impl:5} {row.worlds:7} {row.episodes:>10} {row.held:5} {row.env_steps_per_s:11,.0f} "
                        f"{row.bare_steps_per_s:11,.0f} {row.ratio:6.2f} {row.physics_faults}",
                        flush=True,
                    )
                    if config.out:
                        record = {"conditions": conditions(), "config": str(config), "rows": [asdict(r) for r in rows]}
                        config.out.write_text(json.dumps(record, indent=1))


if __name__ == "__main__":
    main(tyro.cli(Config))
