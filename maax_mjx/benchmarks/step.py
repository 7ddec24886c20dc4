"""How much an env step costs over a bare engine step: `python -m maax_mjx.benchmarks.step --help`.

Both step the same model in the same batch, in turns within one run, under the same forces. Bare is the engine alone:
a loop of `mujoco.batch.Batch.step` for `c`, a scanned, vmapped engine step that carries its mjx.Data for `jax` and
`warp`. An env step adds the overlay, fault containment, poses, observations and automatic resets with new layouts; it
is scanned too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from gymnasium import spaces
from mujoco.batch import Batch
from tqdm import tqdm

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.core.env import Base, Environment
from maax_mjx.core.state import State
from maax_mjx.parallel import WorldsState
from maax_mjx.physics import Data, Fields
from maax_mjx.physics.c_engine import CEngine
from maax_mjx.wrappers.actions import to_bins

if TYPE_CHECKING:
    from mujoco import mjx

    from maax_mjx.physics.mjx_engine import MjxEngine

ROUNDS = 8
DISTINCT = 16
EPISODES = 2.5


@dataclass
class Config:
    """Options.

    Attributes:
        env: environments to time, by name.
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

    env: tuple[str, ...] = ("standard",)
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
    """One measurement: env-steps per second, all worlds added, and what the bare engine makes of `n_frames` physics
    steps each.
    """

    env: str
    n_frames: int
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


Actions = dict[str, jax.Array]
"""An environment's actions, and "forces" (..., n_agents, 3): what the bare engine gets."""


def draw_actions(env: Environment, n_worlds: int, held: int) -> Actions:
    """(DISTINCT, n_worlds, ...) full-range actions: bang-bang where they are held, uniform where redrawn; and locking
    and grabbing at random.
    """
    rng = np.random.default_rng(0)
    actions: dict[str, np.ndarray] = {}
    for name, space in env.action_space.spaces.items():
        shape = (DISTINCT, n_worlds, *(space.shape or ()))
        if name != "move":
            actions[name] = rng.integers(0, 2, shape, np.int8)
            continue
        actions["forces"] = actions["move"] = forces = draw_forces(rng, shape, held)
        if isinstance(space, spaces.MultiDiscrete):
            actions["move"] = to_bins(forces, int(space.nvec.flat[0]))
    return jax.tree.map(jnp.asarray, actions)


def draw_forces(rng: np.random.Generator, shape: tuple[int, ...], held: int) -> np.ndarray:
    """Full-range forces: bang-bang where they are held, uniform where redrawn."""
    forces = rng.choice([-1.0, 1.0], shape) if held > 1 else rng.uniform(-1, 1, shape)
    return forces.astype(np.float32)


def at(actions: Actions, i: jax.Array, held: int) -> Actions:
    """The actions of step `i`."""
    return {name: part[i // held % DISTINCT] for name, part in actions.items()}


Roll = Callable[[Any, Actions, jax.Array, int], Any]
"""`(state, actions, steps, held)` to the state after one env step for each of the step numbers `steps`."""


def env_roll(worlds: maax.Worlds) -> Roll:
    """Env steps with automatic resets, scanned as a training loop scans them."""

    def roll(states: WorldsState, actions: Actions, steps: jax.Array, held: int) -> WorldsState:
        def step(states: WorldsState, i: jax.Array) -> tuple[WorldsState, None]:
            action = at(actions, i, held)
            return worlds.step_fn(states, {name: action[name] for name in worlds.env.action_space.spaces}), None

        return jax.lax.scan(step, states, steps)[0]

    return jax.jit(roll, donate_argnums=0)


def bare_roll(env: Base) -> tuple[Callable[[WorldsState], Any], Roll]:
    """The engine alone: no overlay writes, resets, observations or checks; and what it starts from."""
    engine = env.engine
    ids = env.agents.ctrl_ids.reshape(-1)
    if isinstance(engine, CEngine):
        return lambda states: c_batch(env, engine.c_model, states), c_roll(ids, env.n_frames)
    start, roll = mjx_roll(cast("MjxEngine", engine), ids, env.n_frames)
    return lambda states: start(states.world.fields, states.data), roll


def mjx_roll(
    engine: MjxEngine,
    ids: np.ndarray,
    n_frames: int = 1,
    advance: Callable[[mjx.Model, mjx.Data], mjx.Data] | None = None,
) -> tuple[Callable[[Fields, Data], Any], jax.stages.Wrapped]:
    """The engine's step (or another) of a batch, its forces written to the controls `ids`; and what it starts from."""
    advance = advance or engine.mjx_step

    def start(fields: Fields, states: Data) -> tuple[Fields, mjx.Data]:
        n_worlds = states.time.shape[0]
        return fields, jax.vmap(lambda data: engine.mjx_data(data, n_worlds))(states)

    def roll(carry: tuple[Fields, mjx.Data], actions: Actions, steps: jax.Array, held: int) -> tuple[Fields, mjx.Data]:
        fields, data = carry

        def frame(data: mjx.Data, _: None) -> tuple[mjx.Data, None]:
            return jax.vmap(lambda f, d: advance(engine.mjx_model(f), d))(fields, data), None

        def step(data: mjx.Data, i: jax.Array) -> tuple[mjx.Data, None]:
            forces = at(actions, i, held)["forces"]
            data = data.replace(ctrl=data.ctrl.at[:, ids].set(forces.reshape(len(forces), -1)))
            return jax.lax.scan(frame, data, length=n_frames)[0], None

        return fields, jax.lax.scan(step, data, steps)[0]

    return jax.jit(start), jax.jit(roll, donate_argnums=0)


def c_batch(env: Base, model: mujoco.MjModel, states: State) -> Batch:
    """Plain MuJoCo's batch of some worlds at rest, from the environment's model, perhaps with other options."""
    batch = Batch(model, states.step.shape[0])
    for name, rows in env.overlay.items():
        target = batch.expand(name)
        target[:, rows] = np.asarray(states.world.fields[name]).reshape(len(target), len(rows), *target.shape[2:])
    batch.qpos[...] = np.asarray(states.data.qpos)
    return batch


def c_roll(ids: np.ndarray, n_frames: int = 1) -> Roll:
    """Plain MuJoCo's steps of a batch on all cores, its forces written to the controls `ids`."""

    def roll(batch: Batch, actions: Actions, steps: jax.Array, held: int) -> Batch:
        controls = np.asarray(actions["forces"]).reshape(DISTINCT, len(batch.qpos), -1)
        for i in np.asarray(steps):
            batch.ctrl[:, ids] = controls[i // held % DISTINCT]
            batch.step(nstep=n_frames)
        return batch

    return roll


def measure(name: str, impl: str, n_worlds: int, config: Config) -> Iterator[Row]:
    """Times env steps and bare steps in turns, under every protocol; each is compiled once."""
    n_steps = max(ROUNDS, min(config.steps, int(config.max_world_steps) // n_worlds) // ROUNDS * ROUNDS)
    horizon = max(1, min(config.horizon, int(n_steps / EPISODES)))
    env = maax.make(name, impl=impl, horizon=horizon, contacts_per_world=config.contacts_per_world)
    worlds, base = maax.Worlds(env, n_worlds), env.base
    started = time.perf_counter()
    states = jax.block_until_ready(worlds.reset(jax.random.key(0)))
    start_bare, roll_bare = bare_roll(base)
    rolls = {"env": env_roll(worlds), "bare": roll_bare}
    turns = jnp.arange(n_steps).reshape(ROUNDS, -1)
    actions = draw_actions(env, n_worlds, 1)
    latest = {"bare": start_bare(states), "env": states}
    for which, roll in rolls.items():
        latest[which] = jax.block_until_ready(roll(latest[which], actions, turns[0], 1))
    compile_s = time.perf_counter() - started
    for held in config.held:
        actions = draw_actions(env, n_worlds, held)
        for stagger in (False, True):
            latest.clear()
            states = worlds.reset(jax.random.key(0), stagger=stagger)
            latest = {"bare": jax.block_until_ready(start_bare(states)), "env": states}
            del states
            spent = {"env": 0.0, "bare": 0.0}
            episodes = "staggered" if stagger else "lockstep"
            for steps in tqdm(turns, desc=f"{name} {impl} {n_worlds} {episodes} held {held}", unit="turn", leave=False):
                for which, roll in rolls.items():
                    begun = time.perf_counter()
                    latest[which] = jax.block_until_ready(roll(latest[which], actions, steps, held))
                    spent[which] += time.perf_counter() - begun
            counts = latest["env"].totals()
            total = n_worlds * n_steps
            yield Row(
                env=name,
                n_frames=base.n_frames,
                impl=impl,
                worlds=n_worlds,
                episodes=episodes,
                held=held,
                steps=n_steps,
                horizon=horizon,
                contacts_per_world=base.contacts_per_world,
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
    print("env                    impl   worlds   episodes  held       env/s      bare/s  ratio faults overflow")
    for name, impl, n_worlds in product(config.env, config.impl, config.worlds):
        for row in measure(name, impl, n_worlds, config):
            rows.append(row)
            print(
                f"{row.env:22} {row.impl:5} {row.worlds:7} {row.episodes:>10} {row.held:5} "
                f"{row.env_steps_per_s:11,.0f} {row.bare_steps_per_s:11,.0f} {row.ratio:6.2f} "
                f"{row.physics_faults:6} {row.contact_overflows:8}",
                flush=True,
            )
            record.write(config.out, config, rows)


if __name__ == "__main__":
    main(tyro.cli(Config))
