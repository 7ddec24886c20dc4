"""Faults of the physics in games under hostile play: full forces that are held, and random ones.

Bang-bang actions held for 1 to 1,000 steps push everything into walls and corners, where solvers fail; locks and grabs
are random, and held as long. Random actions redrawn every step average to no force and hide it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnasium import spaces

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.bench import Command, Impl, Options, fill
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_choice
from maax_mjx.common.progress import progress
from maax_mjx.parallel import WorldsState

CHUNK = 50
"""Env steps of a call; rollouts are whole calls."""
FORCES = ("full", "random")
"""Kinds of play: bang-bang, or uniform."""


class Seen(struct.PyTreeNode):
    """Properties of all that a user saw during a rollout.

    Attributes:
        finite: () bool, no number of observations, rewards or physics was NaN or infinite.
        inside: () bool, no agent's centre was ever left further outside a closed arena than a fault's margin.
        truncating: () bool, every fault truncated its world.
    """

    finite: jax.Array
    inside: jax.Array
    truncating: jax.Array

    @classmethod
    def nothing(cls) -> Seen:
        """The value before the first step."""
        return cls(*(jnp.ones((), bool) for _ in range(3)))

    def and_(self, states: WorldsState, agents: np.ndarray) -> Seen:
        """The value after one more step; `agents` are ids of bodies."""
        leaves = jax.tree.leaves((states.obs, states.final_obs, states.reward, states.data.replace(engine=())))
        floats = [x for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)]
        plan = states.world.plan
        middle = plan.floor_size[:, None, None] / 2
        out = (jnp.abs(states.data.xpos[:, agents, :2] - middle) >= middle + 0.31).any(axis=(1, 2))
        return Seen(
            finite=self.finite & jnp.stack([jnp.isfinite(x).all() for x in floats]).all(),
            inside=self.inside & ~(out & plan.closed).any(),
            truncating=self.truncating & (states.metrics["physics_fault"] <= states.truncated).all(),
        )


def actions(env: maax.Environment, n_worlds: int, key: jax.Array, full: jax.Array | bool) -> dict[str, jax.Array]:
    """Random actions of all worlds; where `full` () holds, every force and torque is the greatest, either way."""
    draw_key, side_key = jax.random.split(key)
    action = jax.vmap(env.sample_action)(jax.random.split(draw_key, n_worlds))
    space, move = env.action_space["move"], action["move"]
    low, high = (0, space.nvec - 1) if isinstance(space, spaces.MultiDiscrete) else (-1.0, 1.0)
    greatest = jnp.where(jax.random.bernoulli(side_key, shape=move.shape), high, low)
    return action | {"move": jnp.where(full, greatest.astype(move.dtype), move)}


def player(worlds: maax.Worlds) -> Callable[..., tuple[WorldsState, Seen]]:
    """A compiled rollout `(states, seen, steps, held, full=True)` of actions held for a traced number of steps."""
    base = worlds.env.base

    def play(
        states: WorldsState, seen: Seen, steps: jax.Array, held: int, full: jax.Array | bool = True
    ) -> tuple[WorldsState, Seen]:
        def step(carry: tuple[WorldsState, Seen], t: jax.Array) -> tuple[tuple[WorldsState, Seen], None]:
            states, seen = carry
            key = jax.random.fold_in(jax.random.key(0), t // held)
            states = worlds.step_fn(states, actions(worlds.env, worlds.n_worlds, key, full))
            return (states, seen.and_(states, base.agents.body_ids)), None

        return jax.lax.scan(step, (states, seen), steps)[0]

    return jax.jit(play, donate_argnums=0)


@dataclass
class Config(Options):
    """Options.

    Attributes:
        max_minutes: after about so long it ends: every rollout gets its share of what is left, and ends early.
        games: names of games; all that are registered if left out.
        impl: engines.
        worlds: batch size.
        steps: env steps of every rollout, at most.
        held: for how many steps full forces are held. Random ones are redrawn every step.
        gravity: m/s^2; the game's own if left out.
        contacts_per_world: room for contact points; the environment's own choice if left out.
        keep_faults: folder for the last moments of worlds with faults; see `maax.Worlds`.
    """

    games: tuple[str, ...] = ()
    impl: tuple[Impl, ...] = ("c",)
    worlds: PositiveCount = 1000
    steps: PositiveCount = 1000
    held: tuple[PositiveCount, ...] = (1, 20, 100, 1000)
    gravity: tuple[float, ...] = ()
    contacts_per_world: PositiveCount | None = None
    keep_faults: Path | None = None

    def check(self) -> None:
        super().check()
        for game in self.games:
            check_choice("games", game, maax.tasks())
        if self.steps < CHUNK or self.steps % CHUNK:
            raise ValueError(f"steps: got {self.steps}; takes a multiple of {CHUNK}")


@dataclass(frozen=True)
class Case:
    """One rollout; force as in `FORCES`; gravity in m/s^2, None is the game's own; env steps at most."""

    game: str
    impl: str
    worlds: int
    steps: int
    force: str
    held: int
    gravity: float | None


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case; counts are over all worlds and steps.

    Attributes:
        physics_steps: number that was measured, of all worlds added.
        faults_per_million: physics faults in a million of these.
        contacts_per_world: room for contact points.
        finite, inside, faults_truncate: as in `Seen`.
        physics_faults, contact_overflows, layouts_invalid: counts.
        env_steps_per_s: all worlds added.
    """

    physics_steps: int
    faults_per_million: float
    contacts_per_world: int
    finite: bool
    inside: bool
    faults_truncate: bool
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int
    env_steps_per_s: float


def cases(config: Config) -> Iterator[Case]:
    """Rollouts of one game follow one another, since they compile once."""
    plays = [("random", 1), *(("full", held) for held in config.held)]
    worlds = product(config.impl, config.games or maax.tasks(), config.gravity or (None,))
    for (impl, game, gravity), (force, held) in product(worlds, plays):
        yield Case(game, impl, config.worlds, config.steps, force, held, gravity)


@lru_cache(maxsize=1)
def compiled(
    game: str,
    impl: str,
    n_worlds: int,
    gravity: float | None,
    contacts_per_world: int | None,
    keep_faults: Path | None = None,
) -> tuple[maax.Worlds, Callable]:
    """A batch of a game, and its rollout, compiled."""
    # Only what is asked for: a game of one's own may have no such fields.
    options: dict[str, Any] = {"impl": impl}
    if contacts_per_world is not None:
        options["contacts_per_world"] = contacts_per_world
    if gravity is not None:
        options["world_params.gravity"] = gravity
    worlds = maax.Worlds(maax.make(game, **options), n_worlds, keep_faults=keep_faults)
    play = player(worlds)
    jax.block_until_ready(play(worlds.reset(jax.random.key(0)), Seen.nothing(), jnp.arange(CHUNK), 1, True))
    return worlds, play


def batch(case: Case, config: Config) -> tuple[maax.Worlds, Callable]:
    """The batch of a case, and its rollout, compiled."""
    return compiled(case.game, case.impl, case.worlds, case.gravity, config.contacts_per_world, config.keep_faults)


def measure(case: Case, config: Config, end: float) -> Row:
    """Plays a case until it or the time (`time.monotonic`) ends, and looks at every step."""
    worlds, play = batch(case, config)
    states, seen = worlds.reset(jax.random.key(0)), Seen.nothing()
    named = f"{case.game} {case.impl} {case.force} held {case.held}"
    begun, env_steps = time.perf_counter(), 0
    for steps in progress(jnp.arange(case.steps).reshape(-1, CHUNK), desc=named, unit=f"{CHUNK} steps", leave=False):
        states, seen = jax.block_until_ready(play(states, seen, steps, case.held, case.force == "full"))
        env_steps += case.worlds * CHUNK
        if time.monotonic() > end:
            break
    rate = env_steps / (time.perf_counter() - begun)
    counts, base = states.totals(), worlds.env.base
    physics_steps = env_steps * base.n_frames
    return Row(
        **vars(case),
        physics_steps=physics_steps,
        faults_per_million=1e6 * counts["physics_fault"] / physics_steps,
        contacts_per_world=base.contacts_per_world,
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
    gravity = "" if row.gravity is None else f", gravity {row.gravity}"
    return (
        f"{row.game} {row.impl} {row.worlds:,} worlds{gravity}, {row.force} force held {row.held}: "
        f"{row.physics_faults} faults in {row.physics_steps:,} physics steps, {row.faults_per_million:.2f} a million; "
        f"finite {row.finite}, inside {row.inside}, faults truncate {row.faults_truncate}; {row.contact_overflows} "
        f"overflows, {row.layouts_invalid} invalid layouts; {row.env_steps_per_s:,.0f} env-steps/s"
    )


def main(config: Config) -> None:
    """Measures the cases that the file lacks, within the minutes."""
    config.check()
    rows, wanted = record.resume(config.out, Row), list(cases(config))
    end = time.monotonic() + 60 * (math.inf if config.max_minutes is None else config.max_minutes)

    def in_time(case: Case) -> Row:
        batch(case, config)  # compiles, which is no part of a rollout's share
        begun = time.monotonic()
        return measure(case, config, begun + (end - begun) / (len(wanted) - wanted.index(case)))

    fill(config, rows, wanted, in_time, line)


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
