"""How much an env step costs over a bare engine step: `python -m maax_mjx.benchmarks.step --help`.

Both step the same model in the same batch, in turns within one run, under the same actions. Bare is the engine alone:
a loop of `mujoco.batch.Batch.step` for `c`, a scanned, vmapped `mjx.step` that carries its mjx.Data for `jax`. An env
step adds the overlay, fault containment, poses, observations and automatic resets with new layouts; it is scanned too.
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
DISTINCT = 16
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


def draw_actions(env: Base, n_worlds: int, held: int) -> np.ndarray:
    """(DISTINCT, n_worlds, n_agents, 3) full-range actions: bang-bang where they are held, uniform where redrawn."""
    rng = np.random.default_rng(0)
    shape = (DISTINCT, n_worlds, env.n_agents, 3)
    moves = rng.choice([-1.0, 1.0], shape) if held > 1 else rng.uniform(-1, 1, shape)
    return moves.astype(np.float32)


Turn = Callable[[np.ndarray], None]
"""Steps once for every index of an array of step numbers, and waits for the result."""


def env_turn(worlds: maax.Worlds, states: WorldsState, moves: np.ndarray, held: int) -> tuple[Turn, list[WorldsState]]:
    """Env steps with automatic resets, scanned as a training loop scans them; the latest states are in the list."""
    on_device = jnp.asarray(moves)
    latest = [states]

    def step(states: WorldsState, i: jax.Array) -> tuple[WorldsState, None]:
        return worlds.step_fn(states, {"move": on_device[i // held % DISTINCT]}), None

    roll = jax.jit(lambda states, steps: jax.lax.scan(step, states, steps)[0], donate_argnums=0)

    def turn(steps: np.ndarray) -> None:
        latest[0] = jax.block_until_ready(roll(latest[0], jnp.asarray(steps)))

    return turn, latest


def bare_turn(env: Base, states: WorldsState, moves: np.ndarray, held: int) -> Turn:
    """The engine alone from the same worlds: no overlay writes, resets, observations or checks."""
    n_worlds = states.step.shape[0]
    ids = env.agents.ctrl_ids.reshape(-1)
    engine = env.engine
    if isinstance(engine, CEngine):
        batch = Batch(engine.c_model, n_worlds)
        for name, rows in env.overlay.items():
            batch.expand(name)[:, rows] = states.world.fields[name]
        batch.qpos[...] = np.asarray(states.data.qpos)
        controls = moves.reshape(DISTINCT, n_worlds, -1).astype(float)

        def turn_c(steps: np.ndarray) -> None:
            for i in steps:
                batch.ctrl[:, ids] = controls[i // held % DISTINCT]
                batch.step()

        return turn_c

    on_device = jnp.asarray(moves.reshape(DISTINCT, n_worlds, -1))
    world = jax.tree.map(jnp.copy, states.world)
    latest = [jax.jit(jax.vmap(engine.mjx.data))(states.data)]

    def step(data: mjx.Data, i: jax.Array) -> tuple[mjx.Data, None]:
        data = data.replace(ctrl=data.ctrl.at[:, ids].set(on_device[i // held % DISTINCT]))
        return jax.vmap(lambda w, d: mjx.step(engine.mjx.overlay(w), d))(world, data), None

    roll = jax.jit(lambda data, steps: jax.lax.scan(step, data, steps)[0], donate_argnums=0)

    def turn(steps: np.ndarray) -> None:
        latest[0] = jax.block_until_ready(roll(latest[0], jnp.asarray(steps)))

    return turn


def measure(impl: str, n_worlds: int, stagger: bool, held: int, config: Config) -> Row:
    """Times env steps and bare steps in turns."""
    env = maax.make("standard", impl=impl, horizon=config.horizon).base
    worlds = maax.Worlds(env, n_worlds)
    states = worlds.reset(jax.random.key(0), stagger=stagger)
    moves = draw_actions(env, n_worlds, held)
    bare = bare_turn(env, states, moves, held)
    stepped, latest = env_turn(worlds, states, moves, held)
    spent = {"env": 0.0, "bare": 0.0}
    turns = np.arange(config.steps // ROUNDS * ROUNDS).reshape(ROUNDS, -1)
    for turn in (stepped, bare):  # compiles
        turn(turns[0])
    label = f"{impl} {n_worlds} {'staggered' if stagger else 'lockstep'} held {held}"
    for steps in tqdm(turns, desc=label, unit="turn", leave=False):
        for name, turn in (("env", stepped), ("bare", bare)):
            start = time.perf_counter()
            turn(steps)
            spent[name] += time.perf_counter() - start
    counts = {name: int(value.sum()) for name, value in latest[0].counts.items()}
    total = n_worlds * turns.size
    return Row(
        impl=impl,
        worlds=n_worlds,
        episodes="staggered" if stagger else "lockstep",
        held=held,
        env_steps_per_s=round(total / spent["env"]),
        bare_steps_per_s=round(total / spent["bare"]),
        ratio=round(spent["bare"] / spent["env"], 3),
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
