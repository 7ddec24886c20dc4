"""Protocol of the thesis (formula 6.2), which `scaling`, `engines` and `objects` share.

A figure is the mean over rollouts of T env steps of all worlds, after a warm-up that is such a rollout itself. Rollouts
follow one another without a pause. Actions are uniform and redrawn at every step, unless they are held.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options
from maax_mjx.benchmarks.stepping import (
    DISTINCT,
    Actions,
    Roll,
    bare_roll,
    c_roll,
    draw_actions,
    draw_forces,
    env_roll,
    mjx_roll,
)
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_choice, check_positive
from maax_mjx.common.runtime import is_out_of_memory
from maax_mjx.parallel import WorldsState
from maax_mjx.physics import make_engine

if TYPE_CHECKING:
    from maax_mjx.physics.mjx_engine import MjxEngine

WHAT = ("env", "bare")
BAD = [int(getattr(mujoco.mjtWarning, f"mjWARN_BADQ{of}")) for of in ("POS", "VEL", "ACC")]


@dataclass
class Protocol(Options):
    """Options of the benchmarks that share it.

    Attributes:
        steps: env steps of a rollout, the thesis's T.
        large: the largest batch that gets as many.
        large_steps: env steps of a rollout of larger batches.
        rollouts: of which the mean is taken, after one to warm up.
        max_seconds: after so long no further rollout of a row is begun; the row says how many there were.
    """

    steps: PositiveCount = 1000
    large: PositiveCount = 4096
    large_steps: PositiveCount = 100
    rollouts: PositiveCount = 5
    max_seconds: float = 120.0

    def check(self) -> None:
        super().check()
        check_positive("max_seconds", self.max_seconds)

    def steps_of(self, n_worlds: int) -> int:
        """T of a batch."""
        return self.steps if n_worlds <= self.large else self.large_steps


@dataclass(frozen=True)
class Figures:
    """Figures of a batch; None where they were not measured.

    Attributes:
        steps: env steps of a rollout, T.
        rollouts: how many were timed.
        seconds: of a rollout, the mean.
        seconds_std: their standard deviation.
        steps_per_s: env steps of all worlds per second, the mean.
        compile_s: what came before the first timed rollout, less the time of one: models, engine, compilation.
        nan_worlds: with a number that is not finite in their positions at the end; on `c`, worlds that MuJoCo put back.
        faults: of env steps, those that ended an episode for a fault; of engines alone, worlds that are at the end what
            an environment calls a fault, NaN included; null where there is no arena.
        contact_overflows: env steps of a world in which contacts were left out for want of room; null without an env.
        note: why there are no figures.
    """

    steps: int
    rollouts: int
    seconds: float | None = None
    seconds_std: float | None = None
    steps_per_s: float | None = None
    compile_s: float | None = None
    nan_worlds: int | None = None
    faults: int | None = None
    contact_overflows: int | None = None
    note: str = ""


@dataclass(frozen=True)
class Rolling:
    """A batch to roll out.

    Attributes:
        begin: makes its first state.
        roll: what is timed.
        draw: the forces of a rollout, by the number of steps that each is held.
        positions: of a state, (n_worlds, nq), NaN in worlds that diverged.
        counts: of a state, further counts of `Figures` by name.
    """

    begin: Callable[[], Any]
    roll: Roll
    draw: Callable[[int], Actions]
    positions: Callable[[Any], np.ndarray]
    counts: Callable[[Any], dict[str, Any]] = lambda state: {}


def measure(make: Callable[[], Rolling], n_worlds: int, protocol: Protocol, held: int = 1) -> Figures:
    """Times rollouts of a batch; where it does not fit into memory, the figures say so and nothing else."""
    n_steps = protocol.steps_of(n_worlds)
    try:
        return _measure(make, n_worlds, n_steps, protocol, held)
    except (RuntimeError, MemoryError) as error:  # JAX's errors are RuntimeErrors.
        if not is_out_of_memory(error):
            raise
        return Figures(n_steps, 0, note="out of memory")


def _measure(make: Callable[[], Rolling], n_worlds: int, n_steps: int, protocol: Protocol, held: int) -> Figures:
    steps = jnp.arange(n_steps)
    begun = time.perf_counter()
    batch = make()
    actions = batch.draw(held)
    state = jax.block_until_ready(batch.roll(batch.begin(), actions, steps, held))
    first = time.perf_counter() - begun
    spent: list[float] = []
    while len(spent) < protocol.rollouts and sum(spent) < protocol.max_seconds:
        begun = time.perf_counter()
        state = jax.block_until_ready(batch.roll(state, actions, steps, held))
        spent.append(time.perf_counter() - begun)
    return Figures(
        steps=n_steps,
        rollouts=len(spent),
        seconds=round(float(np.mean(spent)), 6),
        seconds_std=round(float(np.std(spent)), 6),
        steps_per_s=round(float(np.mean(n_worlds * n_steps / np.array(spent)))),
        compile_s=round(max(0.0, first - float(np.mean(spent))), 1),
        nan_worlds=int((~np.isfinite(np.asarray(batch.positions(state))).all(axis=1)).sum()),
        **batch.counts(state),
    )


def of_worlds(worlds: maax.Worlds, what: str) -> Rolling:
    """Env steps of a batch ("env"), or the steps of its engine alone ("bare").

    Episodes are staggered, so that every rollout, long or short, pays for its share of the resets.
    """

    def draw(held: int) -> Actions:
        return draw_actions(worlds.env, worlds.n_worlds, held)

    if check_choice("what", what, WHAT) == "bare":
        start, roll = bare_roll(worlds.env.base)
        return Rolling(lambda: start(worlds.reset(jax.random.key(0))), roll, draw, positions)

    def counts(states: WorldsState) -> dict[str, int]:
        totals = states.totals()
        return {"faults": totals["physics_fault"], "contact_overflows": totals["contact_overflow"]}

    def begin() -> WorldsState:
        return worlds.reset(jax.random.key(0), stagger=True)

    return Rolling(begin, env_roll(worlds), draw, lambda states: states.data.qpos, counts)


def of_model(model: mujoco.MjModel, impl: str, n_worlds: int, contacts: int) -> Rolling:
    """A plain MuJoCo model, many times, from its keyframe 0; every world under forces of its own.

    Args:
        model: the compiled model; `c` steps it as it is.
        impl: "c", "jax" or "warp".
        n_worlds: how many times.
        contacts: of a world that warp makes room for; MJX-JAX takes its custom numeric `max_contact_points`, if any.
    """
    ids, qpos = np.arange(model.nu), model.key_qpos[0]

    def draw(held: int) -> Actions:
        return forces(model, n_worlds, held)

    if impl == "c":

        def begin() -> Batch:
            batch = Batch(model, n_worlds)
            batch.qpos[...] = qpos
            return batch

        return Rolling(begin, c_roll(ids), draw, positions)
    engine = make_engine(impl, model, {}, contacts, model.neq)
    start, roll = mjx_roll(cast("MjxEngine", engine), ids)
    init = jax.jit(jax.vmap(lambda q: engine.init({}, q)))
    return Rolling(lambda: start({}, init(jnp.tile(qpos, (n_worlds, 1)))), roll, draw, positions)


def forces(model: mujoco.MjModel, n_worlds: int, held: int) -> Actions:
    """Forces for all motors of a model."""
    drawn = draw_forces(np.random.default_rng(0), (DISTINCT, n_worlds, model.nu), held)
    return {"forces": jnp.asarray(drawn)}


def positions(state: Any) -> np.ndarray:
    """Positions in a bare engine's state; NaN in worlds that plain MuJoCo found bad, since it resets them."""
    if isinstance(state, Batch):
        bad = (state.warning[:, BAD, 1] > 0).any(axis=1)
        return np.where(bad[:, None], np.nan, state.qpos)
    return np.asarray(state[1].qpos)
