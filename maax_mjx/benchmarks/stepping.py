"""Steps that benchmarks time: of environments, of engines alone, and the actions for both."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from gymnasium import spaces
from mujoco.batch import Batch

import maax_mjx as maax
from maax_mjx.core.env import Base, Environment
from maax_mjx.core.state import State
from maax_mjx.parallel import WorldsState
from maax_mjx.physics import Data, Fields
from maax_mjx.physics.c_engine import CEngine
from maax_mjx.wrappers.actions import to_bins

if TYPE_CHECKING:
    from mujoco import mjx

    from maax_mjx.physics.mjx_engine import MjxEngine

DISTINCT = 16
"""Different actions of a rollout, which then begins again with the first."""

Actions = dict[str, jax.Array]
"""An environment's actions, and "forces" (..., n_agents, 3): what the bare engine gets."""


def draw_actions(env: Environment, n_worlds: int, held: int) -> Actions:
    """Full-range actions, (DISTINCT, n_worlds, ...): bang-bang if held, else uniform; locks and grabs at random."""
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
    """Full-range forces: bang-bang if held, uniform if redrawn."""
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
    """The engine alone, without overlay writes, resets, observations or checks: the start from states, and the roll."""
    engine = env.engine
    ids = env.agents.ctrl_ids.reshape(-1)
    if isinstance(engine, CEngine):
        return lambda states: c_batch(env, engine.host_model, states), c_roll(ids, env.n_frames)
    start, roll = mjx_roll(cast("MjxEngine", engine), ids, env.n_frames)
    return lambda states: start(states.world.fields, states.data), roll


def mjx_roll(
    engine: MjxEngine,
    ids: np.ndarray,
    n_frames: int = 1,
    advance: Callable[[mjx.Model, mjx.Data], mjx.Data] | None = None,
) -> tuple[Callable[[Fields, Data], Any], jax.stages.Wrapped]:
    """The start from fields and data, and the roll of a batch through an engine of MJX.

    Args:
        engine: it makes the models and data.
        ids: controls that the forces are written to.
        n_frames: physics steps per env step.
        advance: a physics step; None is the engine's own.
    """
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
    """A batch of plain MuJoCo with the states' worlds, at rest.

    Args:
        env: the environment of the states.
        model: its model, or a copy with other options.
        states: their worlds and positions are taken.
    """
    batch = Batch(model, states.step.shape[0])
    for name, rows in env.overlay.items():
        target = batch.expand(name)
        target[:, rows] = np.asarray(states.world.fields[name]).reshape(len(target), len(rows), *target.shape[2:])
    batch.qpos[...] = np.asarray(states.data.qpos)
    return batch


def c_roll(ids: np.ndarray, n_frames: int = 1) -> Roll:
    """Steps of plain MuJoCo on all cores, with the forces written to the controls `ids`."""

    def roll(batch: Batch, actions: Actions, steps: jax.Array, held: int) -> Batch:
        controls = np.asarray(actions["forces"]).reshape(DISTINCT, len(batch.qpos), -1)
        for i in np.asarray(steps):
            batch.ctrl[:, ids] = controls[i // held % DISTINCT]
            batch.step(nstep=n_frames)
        return batch

    return roll
