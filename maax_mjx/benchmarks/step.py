"""How much an env step costs over a bare engine step: `python -m maax_mjx.benchmarks.step --help`.

Both step the same model in the same batch, in turns within one run, under the same actions. Bare is the engine alone:
a loop of `mujoco.batch.Batch.step` for `c`, a scanned, vmapped `mjx.step` that carries its mjx.Data for `jax` and
`warp`. An env step adds the overlay, fault containment, poses, observations and automatic resets with new layouts; it
is scanned too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
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
from maax_mjx.benchmarks import record
from maax_mjx.parallel import WorldsState
from maax_mjx.physics.c_engine import CEngine
from maax_mjx.physics.engine import MjxEngine

ROUNDS = 8
DISTINCT = 16
EPISODES = 2.5


@dataclass
class Config:
    """Options.

    Attributes:
        impl: engines to time.
        worlds: batch sizes.
        steps: env steps per measurement, in turns of an eighth each.
        max_world_steps: fewer steps are taken of large batches, so that worlds x steps stays below this.
        horizon: env steps per episode; at most so many that the steps hold two and a half episodes, so that every world
            is reset twice, the second time from a layout drawn on the way.
        held: for how many steps an action is held; 1 redraws it every step.
        contacts_per_world: room for contact points; as many as the environment takes by itself if left out.
        out: JSON file to write; nothing is written without one.
    """

    impl: tuple[str, ...] = ("c", "jax")
    worlds: tuple[int, ...] = (256,)
    steps: int = 1200
    max_world_steps: float = 2e7
    horizon: int = 1000
    held: tuple[int, ...] = (1, 20)
    contacts_per_world: int | None = None
    out: Path | None = None


@dataclass
class Row:
    """One measurement: env-steps and bare engine steps per second, all worlds added, one physics step each."""

    impl: str
    worlds: int
    episodes: str
    held: int
    steps: int
    horizon: int
    contacts_per_world: int
    env_steps_per_s: float
    bare_steps_per_s: float
    ratio: float
    compile_s: float
    episodes_ended: int
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int
    peak_bytes: int | None


def draw_actions(env: Base, n_worlds: int, held: int) -> np.ndarray:
    """(DISTINCT, n_worlds, n_agents, 3) full-range actions: bang-bang where they are held, uniform where redrawn."""
    rng = np.random.default_rng(0)
    shape = (DISTINCT, n_worlds, env.n_agents, 3)
    moves = rng.choice([-1.0, 1.0], shape) if held > 1 else rng.uniform(-1, 1, shape)
    return moves.astype(np.float32)


Roll = Callable[[Any, jax.Array, jax.Array, int], Any]
"""`(state, moves, steps, held)` to the state after one step for each of the step numbers `steps`."""


def env_roll(worlds: maax.Worlds) -> Roll:
    """Env steps with automatic resets, scanned as a training loop scans them."""

    def roll(states: WorldsState, moves: jax.Array, steps: jax.Array, held: int) -> WorldsState:
        def step(states: WorldsState, i: jax.Array) -> tuple[WorldsState, None]:
            return worlds.step_fn(states, {"move": moves[i // held % DISTINCT]}), None

        return jax.lax.scan(step, states, steps)[0]

    return jax.jit(roll, donate_argnums=0)


def bare_roll(env: Base) -> tuple[Callable[[WorldsState], Any], Roll]:
    """The engine alone: no overlay writes, resets, observations or checks; and what it starts from."""
    engine = env.engine
    ids = env.agents.ctrl_ids.reshape(-1)
    if isinstance(engine, CEngine):
        return lambda states: _c_batch(env, engine, states), lambda *args: _roll_c(ids, *args)
    if not isinstance(engine, MjxEngine):
        raise ValueError(f"impl: got {engine.impl!r}; takes c, jax or warp")

    def start(states: WorldsState) -> tuple[Any, mjx.Data]:
        n_worlds = states.step.shape[0]
        return states.world.fields, jax.vmap(lambda data: engine.mjx_data(data, n_worlds))(states.data)

    def roll(carry: tuple[Any, mjx.Data], moves: jax.Array, steps: jax.Array, held: int) -> tuple[Any, mjx.Data]:
        fields, data = carry

        def step(data: mjx.Data, i: jax.Array) -> tuple[mjx.Data, None]:
            move = moves[i // held % DISTINCT]
            data = data.replace(ctrl=data.ctrl.at[:, ids].set(move.reshape(len(move), -1)))
            return jax.vmap(lambda f, d: mjx.step(engine.mjx_model(f), d))(fields, data), None

        return fields, jax.lax.scan(step, data, steps)[0]

    return jax.jit(start), jax.jit(roll, donate_argnums=0)


def _c_batch(env: Base, engine: CEngine, states: WorldsState) -> Batch:
    batch = Batch(engine.c_model, states.step.shape[0])
    for name, rows in env.overlay.items():
        target = batch.expand(name)
        target[:, rows] = np.asarray(states.world.fields[name]).reshape(len(target), len(rows), *target.shape[2:])
    batch.qpos[...] = np.asarray(states.data.qpos)
    return batch


def _roll_c(ids: np.ndarray, batch: Batch, moves: jax.Array, steps: jax.Array, held: int) -> Batch:
    controls = np.asarray(moves).reshape(*moves.shape[:2], -1)
    for i in np.asarray(steps):
        batch.ctrl[:, ids] = controls[i // held % DISTINCT]
        batch.step()
    return batch


def measure(impl: str, n_worlds: int, config: Config) -> Iterator[Row]:
    """Times env steps and bare steps in turns, under every protocol; each is compiled once."""
    n_steps = max(ROUNDS, min(config.steps, int(config.max_world_steps) // n_worlds) // ROUNDS * ROUNDS)
    horizon = max(1, min(config.horizon, int(n_steps / EPISODES)))
    env = maax.make("standard", impl=impl, horizon=horizon, contacts_per_world=config.contacts_per_world).base
    worlds = maax.Worlds(env, n_worlds)
    started = time.perf_counter()
    states = jax.block_until_ready(worlds.reset(jax.random.key(0)))
    start_bare, roll_bare = bare_roll(env)
    rolls = {"env": env_roll(worlds), "bare": roll_bare}
    turns = jnp.arange(n_steps).reshape(ROUNDS, -1)
    moves = jnp.asarray(draw_actions(env, n_worlds, 1))
    latest = {"bare": start_bare(states), "env": states}
    for name, roll in rolls.items():
        latest[name] = jax.block_until_ready(roll(latest[name], moves, turns[0], 1))
    compile_s = time.perf_counter() - started
    for held in config.held:
        moves = jnp.asarray(draw_actions(env, n_worlds, held))
        for stagger in (False, True):
            latest.clear()
            states = worlds.reset(jax.random.key(0), stagger=stagger)
            latest = {"bare": jax.block_until_ready(start_bare(states)), "env": states}
            del states
            spent = {"env": 0.0, "bare": 0.0}
            episodes = "staggered" if stagger else "lockstep"
            for steps in tqdm(turns, desc=f"{impl} {n_worlds} {episodes} held {held}", unit="turn", leave=False):
                for name, roll in rolls.items():
                    begun = time.perf_counter()
                    latest[name] = jax.block_until_ready(roll(latest[name], moves, steps, held))
                    spent[name] += time.perf_counter() - begun
            counts = latest["env"].totals()
            total = n_worlds * n_steps
            yield Row(
                impl=impl,
                worlds=n_worlds,
                episodes=episodes,
                held=held,
                steps=n_steps,
                horizon=horizon,
                contacts_per_world=env.contacts_per_world,
                env_steps_per_s=round(total / spent["env"]),
                bare_steps_per_s=round(total / spent["bare"]),
                ratio=round(spent["bare"] / spent["env"], 3),
                compile_s=round(compile_s, 1),
                episodes_ended=counts["episodes"],
                physics_faults=counts["physics_fault"],
                contact_overflows=counts["contact_overflow"],
                layouts_invalid=counts["layout_invalid"],
                peak_bytes=(jax.local_devices()[0].memory_stats() or {}).get("peak_bytes_in_use"),
            )


def main(config: Config) -> None:
    """Runs all measurements, prints a table and writes the JSON after each, so that an interruption loses none."""
    rows: list[Row] = []
    print("impl   worlds   episodes  held       env/s      bare/s  ratio faults overflow")
    for impl in config.impl:
        for n_worlds in config.worlds:
            for row in measure(impl, n_worlds, config):
                rows.append(row)
                print(
                    f"{row.impl:5} {row.worlds:7} {row.episodes:>10} {row.held:5} {row.env_steps_per_s:11,.0f} "
                    f"{row.bare_steps_per_s:11,.0f} {row.ratio:6.2f} {row.physics_faults:6} {row.contact_overflows:8}",
                    flush=True,
                )
                record.write(config.out, config, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
