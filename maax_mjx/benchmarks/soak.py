"""Billions of steps under hostile play, over several runs.

Agents have full force, redrawn every 20 steps, while everybody locks and grabs everything in reach. What a user could
see of a step is looked at after each. A run that is stopped or killed goes on from its last checkpoint.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
from flax import struct

import maax_mjx as maax
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.bench import Command, Options
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.progress import progress
from maax_mjx.parallel import WorldsState

COUNTS = ("episodes", "physics_fault", "contact_overflow", "layout_invalid")


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: environment, by name.
        impl: engine.
        worlds: batch size.
        physics_steps: how many in all, of all worlds and runs.
        held: for how many env steps a force is held.
        chunk: env steps of a rollout.
        every: rollouts between checkpoints.
        folder: of the checkpoints, with each of which `out` is written; a later run with the same goes on from the
            last.
    """

    env: str = "hide_and_seek"
    impl: str = "warp"
    worlds: PositiveCount = 16_384
    physics_steps: float = 1e9
    held: PositiveCount = 20
    chunk: PositiveCount = 100
    every: PositiveCount = 10
    folder: Path = Path("soak")


class Tally(struct.PyTreeNode):
    """Counts of what was seen so far.

    Attributes:
        env_steps: () int32, of each world.
        bad_steps: () int32, steps after which some number that a user sees was not finite.
        counts: (4,) float32 totals of all worlds before `states.counts`, which begin at 0 in every rollout,
            since they are int32: by `COUNTS`.
        seconds: () float32 that rollouts took.
    """

    env_steps: jax.Array
    bad_steps: jax.Array
    counts: jax.Array
    seconds: jax.Array

    @classmethod
    def nothing(cls) -> Tally:
        """The tally before the first step."""
        none = jnp.zeros((), jnp.int32)
        return cls(none, none, jnp.zeros(len(COUNTS)), jnp.zeros(()))


@dataclass(frozen=True)
class Row(Measured):
    """Figures of all runs together; `measured` is the last one."""

    env: str
    impl: str
    worlds: int
    held: int
    n_frames: int
    env_steps: int
    physics_steps: int
    steps_with_nan: int
    episodes: int
    physics_faults: int
    contact_overflows: int
    layouts_invalid: int
    faults_per_million_physics_steps: float
    physics_steps_per_s: float
    runs: int


def hostile(env: maax.Environment, worlds: int, key: jax.Array) -> dict[str, jax.Array]:
    """Actions of full force one way or the other, with everything locked and grabbed."""
    spaces = env.action_space.spaces
    action = {name: jnp.ones((worlds, *space.shape), jnp.int8) for name, space in spaces.items() if name != "move"}  # type: ignore[misc]
    forwards = jax.random.bernoulli(key, shape=(worlds, env.base.n_agents, 3))
    bins = getattr(spaces["move"], "nvec", None)
    most, least = (1.0, -1.0) if bins is None else (int(bins.flat[0]) - 1, 0)
    return {**action, "move": jnp.where(forwards, most, least)}


def player(worlds: maax.Worlds, config: Config) -> jax.stages.Wrapped:
    """Compiled `(states, start) -> states, bad`: a chunk of steps from step `start`, and how many showed a NaN."""

    def play(states: WorldsState, start: jax.Array) -> tuple[WorldsState, jax.Array]:
        def step(states: WorldsState, t: jax.Array) -> tuple[WorldsState, jax.Array]:
            key = jax.random.fold_in(jax.random.key(1), t // config.held)
            states = worlds.step_fn(states, hostile(worlds.env, worlds.n_worlds, key))
            public = states.replace(upcoming=(), data=states.data.replace(engine=()))
            floats = [x for x in jax.tree.leaves(public) if jnp.issubdtype(x.dtype, jnp.floating)]
            return states, ~jnp.stack([jnp.isfinite(x).all() for x in floats]).all()

        states, bad = jax.lax.scan(step, states, start + jnp.arange(config.chunk))
        return states, bad.sum()

    return jax.jit(play, donate_argnums=0)


def main(config: Config) -> None:
    """Goes on until all steps are done or the minutes are over."""
    config.check()
    run = record.run_of(config)
    env = maax.make(config.env, impl=config.impl)
    worlds = maax.Worlds(env, config.worlds)
    checkpoints, play, tally, runs = maax.Checkpoints(config.folder), player(worlds, config), Tally.nothing(), 1
    if checkpoints.latest is None:
        states = worlds.reset(jax.random.key(0), stagger=True)
    else:
        states, others = checkpoints.restore(worlds, tally=tally, runs=jnp.ones((), jnp.int32))
        tally, runs = others["tally"], int(others["runs"]) + 1
    per_step = config.worlds * env.base.n_frames
    begun, chunks = time.monotonic(), 0
    total, done = int(config.physics_steps), int(tally.env_steps) * per_step
    with progress(None, "soak", total=total, initial=done, unit_scale=True) as bar:
        while bar.n < config.physics_steps and not _over(begun, config.max_minutes):
            start = time.perf_counter()
            states, bad = jax.block_until_ready(play(states, tally.env_steps))
            chunks += 1
            # The first one compiles.
            seconds = time.perf_counter() - start if chunks > 1 else 0.0
            counts = jnp.array([states.totals()[name] for name in COUNTS], jnp.float32)
            states = states.replace(counts=jax.tree.map(jnp.zeros_like, states.counts))
            tally = Tally(
                tally.env_steps + config.chunk, tally.bad_steps + bad, tally.counts + counts, tally.seconds + seconds
            )
            bar.update(config.chunk * per_step)
            done = bar.n >= config.physics_steps or _over(begun, config.max_minutes)
            if done or chunks % config.every == 0:
                checkpoints.save(int(tally.env_steps), worlds, states, tally=tally, runs=jnp.asarray(runs))
                record.write(config.out, [replace(row_of(tally, config, env.base.n_frames, runs), measured=run)])
    print(row_of(tally, config, env.base.n_frames, runs), flush=True)


def row_of(tally: Tally, config: Config, n_frames: int, runs: int) -> Row:
    """The tally as a row."""
    steps = int(tally.env_steps) * config.worlds
    counts = dict(zip(COUNTS, (int(x) for x in tally.counts), strict=True))
    timed = steps - runs * config.chunk * config.worlds
    return Row(
        env=config.env,
        impl=config.impl,
        worlds=config.worlds,
        held=config.held,
        n_frames=n_frames,
        env_steps=steps,
        physics_steps=steps * n_frames,
        steps_with_nan=int(tally.bad_steps),
        episodes=counts["episodes"],
        physics_faults=counts["physics_fault"],
        contact_overflows=counts["contact_overflow"],
        layouts_invalid=counts["layout_invalid"],
        faults_per_million_physics_steps=round(counts["physics_fault"] / max(steps * n_frames, 1) * 1e6, 4),
        physics_steps_per_s=round(timed * n_frames / float(tally.seconds)) if float(tally.seconds) else 0,
        runs=runs,
    )


def _over(begun: float, minutes: float | None) -> bool:
    return minutes is not None and time.monotonic() - begun > 60 * minutes


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
