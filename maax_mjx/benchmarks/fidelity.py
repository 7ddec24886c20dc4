"""Distance of engines from a converged MuJoCo, by solver iterations.

The reference is C MuJoCo in float64, iterated until it converges, with the same time step, in the same worlds (M, every
world in a layout of its own), from the same states, under the same full forces, held for 20 steps. Two errors are
measured. The free run compares positions after a second; contacts are chaotic, so that a small error of any step can
end as a large one. The single step starts from the reference's state, rounded to float32 as environments keep it, at
moments all along the reference's run. What is measured is an environment's step: faults are contained, and counted.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import DISTINCT, c_batch, draw_actions
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.core.env import Base
from maax_mjx.core.faults import AGENT_CEILING
from maax_mjx.core.state import State
from maax_mjx.modules import Entities
from maax_mjx.parallel.episodes import without_engine
from maax_mjx.physics import check_impl

HELD = 20
QUANTILES = (0.5, 0.9, 0.99)
REFERENCE_ITERATIONS, REFERENCE_LS_ITERATIONS = 200, 200
TOLERANCE, LS_TOLERANCE = 1e-12, 1e-6
STARTS = ("qpos", "qvel", "qacc_warmstart")


@dataclass
class Config(Options):
    """Options.

    Attributes:
        impl: engines to compare.
        iterations: of the solver.
        worlds: how many, the same for every engine.
        steps: physics steps of the free run.
        every: steps of the reference's run from one single step to the next.
    """

    impl: tuple[str, ...] = ("c", "jax")
    iterations: tuple[PositiveCount, ...] = (20, 5, 10, 1, 3)
    worlds: PositiveCount = 64
    steps: PositiveCount = 200
    every: PositiveCount = 10

    def check(self) -> None:
        super().check()
        for impl in self.impl:
            check_impl(impl)


@dataclass(frozen=True)
class Case:
    """One engine at so many solver iterations; `steps` is the length of the free run."""

    impl: str
    iterations: int
    worlds: int
    steps: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case.

    The largest error of an agent's position counts in every world, and that of an object's, in metres; a row has the
    median, the 90 % and the 99 % over worlds, and for single steps over worlds and moments.

    Attributes:
        singles: single steps, over all worlds and moments.
        free_agents_m, free_objects_m: at the end of the free run.
        single_agents_m, single_objects_m: after a single step from the reference's state.
        faulty_worlds: worlds with a physics fault (an agent was ejected, or something was not finite) in the free run,
            which was contained.
        overflowed_worlds: worlds that had more contacts than there was room for, in some step of the free run.
        reference_ejected: worlds in which the reference itself ejected an agent.
        env_steps_per_s: of the free run, all worlds added, stepped from Python.
        compile_s: compilation of the step, with the first call.
    """

    singles: int
    free_agents_m: list[float]
    free_objects_m: list[float]
    single_agents_m: list[float]
    single_objects_m: list[float]
    faulty_worlds: int
    overflowed_worlds: int
    reference_ejected: int
    env_steps_per_s: float
    compile_s: float


@dataclass
class Moment:
    """A state of the reference in float32, (n_worlds, ...), and where a converged step takes it from there."""

    step: int
    qpos: np.ndarray
    qvel: np.ndarray
    qacc_warmstart: np.ndarray
    then: np.ndarray


class Reference:
    """Converged MuJoCo's run of some worlds of M, computed at first use.

    Args:
        impl: the engine whose environment draws the worlds.
        n_worlds: how many.
        n_steps: physics steps.
        every: steps from one moment to the next.
    """

    def __init__(self, impl: str, n_worlds: int, n_steps: int, every: int):
        self.env = make(impl, None)
        keys = jax.random.split(jax.random.key(0), n_worlds)
        states: State = jax.jit(jax.vmap(self.env.reset))(keys)
        self.states = without_engine(states)
        self.actions = draw_actions(self.env, n_worlds, HELD)["move"]
        self.n_worlds, self.n_steps, self.every = n_worlds, n_steps, every

    @cached_property
    def run(self) -> tuple[list[Moment], np.ndarray, int]:
        """The moments, (n_worlds, nq) the positions at the end, and how many worlds ejected an agent."""
        model = converged(self.env.model)
        batch, probe = (c_batch(self.env, model, self.states) for _ in range(2))
        controls = np.asarray(self.actions).reshape(DISTINCT, self.n_worlds, -1)
        ids, heights = self.env.agents.ctrl_ids.reshape(-1), self.env.agents.qpos_ids[:, 2]
        moments, ejected = [], np.zeros(self.n_worlds, bool)
        for t in range(self.n_steps):
            batch.ctrl[:, ids] = controls[t // HELD % DISTINCT]
            if t % self.every == 0:
                starts = {name: np.array(getattr(batch, name), np.float32) for name in STARTS}
                for name, start in starts.items():
                    getattr(probe, name)[...] = start
                probe.ctrl[...] = batch.ctrl
                probe.step()
                moments.append(Moment(step=t, then=np.array(probe.qpos), **starts))
            batch.step()
            ejected |= (batch.qpos[:, heights] > AGENT_CEILING).any(axis=1)
        return moments, np.array(batch.qpos), int(ejected.sum())


@lru_cache(maxsize=1)
def reference(impl: str, n_worlds: int, n_steps: int, every: int) -> Reference:
    """The reference that all engines of a run share."""
    return Reference(impl, n_worlds, n_steps, every)


def make(impl: str, iterations: int | None) -> Base:
    """M on an engine, its solver with so many iterations, or with its own."""
    params = maax.WorldParams() if iterations is None else maax.WorldParams(iterations=iterations)
    return maax.make("standard", impl=impl, world_params=params, horizon=10**6).base


def converged(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model with a solver that goes on until it converges."""
    model = copy.copy(model)
    model.opt.iterations, model.opt.ls_iterations = REFERENCE_ITERATIONS, REFERENCE_LS_ITERATIONS
    model.opt.tolerance, model.opt.ls_tolerance = TOLERANCE, LS_TOLERANCE
    # Bounding volumes of the world body's geoms are those of the compiled model, not of a world's own walls.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    return model


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    return (Case(i, n, config.worlds, config.steps) for i, n in product(config.impl, config.iterations))


def measure(case: Case, config: Config) -> Row:
    """Runs an engine freely and step by step beside the reference."""
    truth = reference(config.impl[0], case.worlds, case.steps, config.every)
    env, states = make(case.impl, case.iterations), truth.states
    moments, end, ejected = truth.run
    engine = env.engine
    states = states.replace(data=states.data.replace(engine=jax.vmap(engine.carry)(states.data)))
    step = jax.jit(jax.vmap(env.step))

    def actions(t: int) -> dict[str, jax.Array]:
        return {"move": truth.actions[t // HELD % DISTINCT]}

    begun = time.perf_counter()
    jax.block_until_ready(step(states, actions(0)))
    compile_s = time.perf_counter() - begun
    run, faulty, full = states, *(jnp.zeros(case.worlds, bool) for _ in range(2))
    begun = time.perf_counter()
    for t in range(case.steps):
        run = step(run, actions(t))
        faulty |= run.metrics["physics_fault"]
        full |= run.metrics["contact_overflow"]
    jax.block_until_ready(run)
    spent = time.perf_counter() - begun
    free = errors(states, env, run.data.qpos, end)
    singles: list[dict[str, np.ndarray]] = []
    for moment in moments:
        starts = {name: jnp.asarray(getattr(moment, name)) for name in STARTS}
        stepped = step(states.replace(data=states.data.replace(**starts)), actions(moment.step))
        singles.append(errors(states, env, stepped.data.qpos, moment.then))
    single = {name: np.concatenate([one[name] for one in singles]) for name in free}
    return Row(
        **vars(case),
        singles=len(moments) * case.worlds,
        free_agents_m=quantiles(free["agents"]),
        free_objects_m=quantiles(free["objects"]),
        single_agents_m=quantiles(single["agents"]),
        single_objects_m=quantiles(single["objects"]),
        faulty_worlds=int(faulty.sum()),
        overflowed_worlds=int(full.sum()),
        reference_ejected=ejected,
        env_steps_per_s=round(case.worlds * case.steps / spent),
        compile_s=round(compile_s, 1),
    )


def errors(states: State, env: Base, qpos: jax.Array, true: np.ndarray) -> dict[str, np.ndarray]:
    """Largest error of a position in metres, (n_worlds,), of "agents" and of "objects"."""
    objects: list[Entities] = [module for module in env.movables if module is not env.agents]
    found = {}
    for name, modules in (("agents", [env.agents]), ("objects", objects)):
        ids = np.concatenate([module.qpos_ids[:, :3] for module in modules])
        active = np.concatenate([states.world.active[module.kind] for module in modules], axis=1)
        away = np.linalg.norm(np.asarray(qpos, float)[:, ids] - true[:, ids], axis=-1)
        found[name] = np.where(active, away, 0.0).max(axis=1)
    return found


def quantiles(values: np.ndarray) -> list[float]:
    """The median, the 90 % and the 99 %."""
    return [float(f"{q:.4g}") for q in np.quantile(values, QUANTILES)]


def line(row: Row) -> str:
    """A line about a row."""
    free, single = (f"{m[0]:.1e} / {m[1]:.1e} / {m[2]:.1e}" for m in (row.free_agents_m, row.single_agents_m))
    return (
        f"{row.impl:5} {row.iterations:3} iterations: agents off by {free} m after {row.steps} steps, by {single} m "
        f"after one (median / 90 % / 99 %); {row.faulty_worlds} faulty worlds; {row.env_steps_per_s:,.0f} steps/s"
    )


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
