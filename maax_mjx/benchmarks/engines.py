"""Steps per second of engines on one and the same MJCF file (thesis figure 6.4, table 6.1).

The file is one exported world of M, loaded by plain MuJoCo: nothing of this package is in the way. All worlds of a
batch start from it alike, and every world has forces of its own. `c` is plain MuJoCo on all cores, whatever JAX
computes on. `brax` is Brax's generalized pipeline (the extra "brax"), on the file as `for_brax` says,
with exact inverses of the mass matrix; `brax-approximate` has the approximate ones that are Brax's default, with which
it takes damping explicitly, too much for M's agents.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib.util import find_spec
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import maax_mjx as maax
from maax_mjx.benchmarks import record, rollouts
from maax_mjx.benchmarks.bench import Command, fill
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.rollouts import Figures, Protocol, Rolling
from maax_mjx.benchmarks.stepping import Actions, at
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.core.env import Base
from maax_mjx.core.faults import find_fault
from maax_mjx.core.state import State

ENGINES = ("warp", "jax", "c", "brax", "brax-approximate")
LIBRARIES = {"warp": "warp", "brax": "brax", "brax-approximate": "brax"}
"""Libraries that may be missing, by engine."""
MISSING = "not installed"
"""Note of a row without figures, for which a later run tries again."""
BRAX = {"brax": 0, "brax-approximate": 10}
"""Iterations of Brax's approximate inverse; 0 inverts exactly."""
LIGHT = 1e-3
"""kg, and kg m^2, of the links that Brax needs besides; a thousandth of what hangs on them."""


@dataclass
class Config(Protocol):
    """Options.

    Attributes:
        engines: of "warp", "jax", "c", "brax" and "brax-approximate".
        worlds: batch sizes; the larger ones come first.
        iterations: of the solver, and of its line searches; the thesis had 5.
        held: for how many steps an action is held; 1 redraws it every step, which averages to no force.
    """

    engines: tuple[str, ...] = ("c", "jax")
    worlds: tuple[PositiveCount, ...] = (4096,)
    iterations: tuple[PositiveCount, ...] = (20, 5)
    held: tuple[PositiveCount, ...] = (1, 20)

    def check(self) -> None:
        super().check()
        for engine in self.engines:
            check_choice("engines", engine, ENGINES)


@dataclass(frozen=True)
class Case:
    """Measurement to be made."""

    engine: str
    worlds: int
    iterations: int
    held: int


@dataclass(frozen=True)
class Row(Figures, Case, Measured):
    """A case and its figures."""


def cases(config: Config) -> Iterator[Case]:
    """Cases; those that differ in their actions alone are neighbours, since they compile once."""
    for engine, n_worlds, iterations, held in product(
        config.engines, sorted(config.worlds, reverse=True), config.iterations, config.held
    ):
        yield Case(engine, n_worlds, iterations, held)


@lru_cache(maxsize=1)
def exported() -> tuple[Base, State, str]:
    """M, a state of it, and the file of that state."""
    env = maax.make("standard", impl="jax").base
    # Only drawn, not stepped: any engine will do, and this one there is everywhere.
    state = jax.device_get(jax.jit(env.reset)(jax.random.key(0)))
    return env, state, maax.to_mjcf(env, state)


def make(case: Case) -> Rolling:
    """The batch of a case, with a count of the worlds that are faults at the end."""
    batch = _batch(case.engine, case.worlds, case.iterations)
    return replace(batch, counts=lambda state: {"faults": count_faults(batch.positions(state))})


@lru_cache(maxsize=1)
def _batch(engine: str, n_worlds: int, iterations: int) -> Rolling:
    """A batch, kept for the next case: cases that differ in their actions alone compile once."""
    env, _, xml = exported()
    model = mujoco.MjModel.from_xml_string(for_brax(xml) if engine in BRAX else xml)
    model.opt.iterations = model.opt.ls_iterations = iterations
    if engine in BRAX:
        return _brax(model, n_worlds, BRAX[engine])
    return rollouts.of_model(model, engine, n_worlds, env.contacts_per_world)


def count_faults(positions: np.ndarray) -> int:
    """Number of worlds, of those at `positions` (n_worlds, nq), that an environment calls faulty, NaN included."""
    env, first, _ = exported()
    ids = np.concatenate([m.qpos_ids[:, :3] for m in env.movables])
    is_agent = np.concatenate([np.full(m.n_max, m is env.agents) for m in env.movables])

    def is_fault(qpos: jax.Array) -> jax.Array:
        return find_fault(
            first.data.replace(qpos=qpos), first.world.plan, qpos[ids], jnp.ones(len(ids), bool), is_agent
        )

    return int(jax.vmap(is_fault)(jnp.asarray(positions, jnp.float32)).sum())


def for_brax(xml: str) -> str:
    """The file as Brax takes it.

    Brax knows no four joints on one body and no reference positions: bodies turn on a light link that slides, and their
    coordinates count from the world's origin, as they do in the file. Positions, axes and masses stay.
    """
    root = ET.fromstring(xml)
    for body in root.findall("worldbody/body"):
        slides = body.findall("joint[@type='slide']")
        references = [float(joint.attrib.pop("ref", "0")) for joint in slides]
        position = np.array(str(body.get("pos")).split(), float) - references
        body.set("pos", " ".join(repr(float(x)) for x in position))
        turning = ET.Element("body", name=f"{body.get('name')}:turning")
        for element in [element for element in body if element not in slides]:
            body.remove(element)
            turning.append(element)
        ET.SubElement(body, "inertial", pos="0 0 0", mass=str(LIGHT), diaginertia=" ".join([str(LIGHT)] * 3))
        body.append(turning)
    return ET.tostring(root, encoding="unicode")


def _brax(model: mujoco.MjModel, n_worlds: int, inverse_iterations: int) -> Rolling:
    from brax.generalized import pipeline
    from brax.io import mjcf

    with warnings.catch_warnings(action="ignore"):  # It says that it is no longer maintained.
        system = mjcf.load_model(model)
    system = system.replace(matrix_inv_iterations=inverse_iterations, solver_maxls=model.opt.ls_iterations)

    @jax.jit
    def begin() -> Any:
        first = pipeline.init(system, jnp.asarray(model.key_qpos[0]), jnp.zeros(model.nv))
        return jax.tree.map(lambda x: jnp.tile(x, (n_worlds, *[1] * x.ndim)), first)

    def roll(state: Any, actions: Actions, steps: jax.Array, held: int) -> Any:
        def step(state: Any, i: jax.Array) -> tuple[Any, None]:
            return jax.vmap(partial(pipeline.step, system))(state, at(actions, i, held)["forces"]), None

        return jax.lax.scan(step, state, steps)[0]

    draw = partial(rollouts.forces, model, n_worlds)
    return Rolling(begin, jax.jit(roll, donate_argnums=0), draw, lambda state: np.asarray(state.q))


def measure(case: Case, config: Config) -> Row:
    """Times rollouts of a case, if its library is installed."""
    if case.engine in LIBRARIES and find_spec(LIBRARIES[case.engine]) is None:
        figures = Figures(config.steps_of(case.worlds), 0, note=MISSING)
    else:
        figures = rollouts.measure(partial(make, case), case.worlds, config, case.held)
    return Row(**vars(case), **vars(figures))


HEADER = "engine  worlds  iterations  held     T  rollouts   seconds       steps/s  compile s    NaN  faults  note"


def line(row: Row) -> str:
    """A row of the table."""
    start = f"{row.engine:6} {row.worlds:7} {row.iterations:11} {row.held:5} {row.steps:5}"
    if row.seconds is None:
        return f"{start} {row.note}"
    return (
        f"{start} {row.rollouts:9} {row.seconds:9.3f} {row.steps_per_s:13,.0f} {row.compile_s:10.1f} "
        f"{row.nan_worlds:6} {row.faults:7}"
    )


def main(config: Config) -> None:
    """Measures every case that the file lacks, or for which a library was missing."""
    config.check()
    rows = [row for row in record.resume(config.out, Row) if row.note != MISSING]
    fill(config, rows, cases(config), lambda case: measure(case, config), line, HEADER)


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
