"""Faults of the physics under full forces that are held.

Bang-bang actions held for 1 to 1,000 steps push everything into walls and corners, where solvers fail. Random actions
redrawn every step average to no force and hide it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import jax
import jax.numpy as jnp
from flax import struct

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.progress import progress
from maax_mjx.parallel import WorldsState

CHUNK = 50
"""Env steps of a call; rollouts are whole calls."""


class Seen(struct.PyTreeNode):
    """Properties of all that a user saw during a rollout.

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
        """The value before the first step."""
        return cls(*(jnp.ones((), bool) for _ in range(3)))

    def and_(self, states: WorldsState, agents: jax.Array, floor_size: float) -> Seen:
        """The value after one more step; `agents` are (n_worlds, n_agents, 3) positions."""
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
class Config(Options):
    """Options.

    Attributes:
        impl: engines.
        worlds: batch size.
        steps: env steps of every rollout.
        held: for how many steps an action is held.
        gravity: m/s^2.
        contacts_per_world: room for contact points; the environment's own choice if left out.
    """

    impl: tuple[str, ...] = ("c",)
    worlds: PositiveCount = 1000
    steps: PositiveCount = 1000
    held: tuple[PositiveCount, ...] = (1, 20, 100, 1000)
    gravity: tuple[float, ...] = (-9.81, -50.0)
    contacts_per_world: PositiveCount | None = None

    def check(self) -> None:
        super().check()
        if self.steps < CHUNK or self.steps % CHUNK:
            raise ValueError(f"steps: got {self.steps}; takes a multiple of {CHUNK}")


@dataclass(frozen=True)
class Case:
    """One rollout; gravity in m/s^2."""

    impl: str
    worlds: int
    steps: int
    held: int
    gravity: float


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case; counts are over all worlds and steps.

    Attributes:
        contacts_per_world: room for contact points.
        finite, inside, faults_truncate: as in `Seen`.
        physics_faults, contact_overflows, layouts_invalid: counts.
        env_steps_per_s: all worlds added.
    """

    contacts_per_world: int
    finite: bool
    inside: bool
    faults_truncate: bool
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int
    env_steps_per_s: float


def cases(config: Config) -> Iterator[Case]:
    """Rollouts of one world follow one another, since they compile once."""
    for impl, gravity, held in product(config.impl, config.gravity, config.held):
        yield Case(impl, config.worlds, config.steps, held, gravity)


@lru_cache(maxsize=1)
def compiled(impl: str, n_worlds: int, gravity: float, contacts_per_world: int | None) -> tuple[maax.Worlds, Callable]:
    """A batch of M, and its rollout, compiled."""
    params = maax.WorldParams(gravity=gravity)
    env = maax.make("standard", impl=impl, world_params=params, contacts_per_world=contacts_per_world).base
    worlds = maax.Worlds(env, n_worlds)
    play = player(worlds)
    jax.block_until_ready(play(worlds.reset(jax.random.key(0)), Seen.nothing(), jnp.arange(CHUNK), 1))
    return worlds, play


def measure(case: Case, config: Config) -> Row:
    """Plays a case, and looks at every step."""
    worlds, play = compiled(case.impl, case.worlds, case.gravity, config.contacts_per_world)
    states, seen = worlds.reset(jax.random.key(0)), Seen.nothing()
    named = f"{case.impl} g {case.gravity} held {case.held}"
    begun = time.perf_counter()
    for steps in progress(jnp.arange(case.steps).reshape(-1, CHUNK), desc=named, unit=f"{CHUNK} steps", leave=False):
        states, seen = jax.block_until_ready(play(states, seen, steps, case.held))
    rate = case.worlds * case.steps / (time.perf_counter() - begun)
    counts = states.totals()
    return Row(
        **vars(case),
        contacts_per_world=worlds.env.base.contacts_per_world,
        finite=bool(seen.finite),
        inside=bool(seen.inside),
        faults_truncate=bool(seen.truncating),
        physics_faults=counts["physics_fault"],
        contact_overflows=counts["contact_overflow"],
        layouts_invalid=counts["layout_invalid"],
        env_steps_per_s=round(rate),
    )


def line(row: Row) -> str:
    """A line about a row."""
    return (
        f"{row.impl} {row.worlds:,} worlds, gravity {row.gravity}, held {row.held}: finite {row.finite}, inside "
        f"{row.inside}, faults truncate {row.faults_truncate}; {row.physics_faults} faults, {row.contact_overflows} "
        f"overflows, {row.layouts_invalid} invalid layouts; {row.env_steps_per_s:,.0f} env-steps/s"
    )


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
