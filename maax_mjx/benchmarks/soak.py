"""Billions of steps under hostile play, or of a trained policy, over several runs.

Agents have full force, redrawn every 20 steps, while everybody locks and grabs everything in reach; with `--policy`
trained agents play. What a user could see of a step is looked at after each, and faults are counted by what agents
did. A run that is stopped or killed goes on from its last checkpoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.benchmarks import record
from maax_mjx.benchmarks.bench import Command, Impl, Options
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.progress import progress
from maax_mjx.parallel import WorldsState
from maax_mjx.parallel.policy import forgotten
from maax_mjx.wrappers.grabs.wrapper import GrabObjects
from maax_mjx.wrappers.tools import HIGH
from maax_mjx.wrappers.wrapper import find

COUNTS = ("episodes", "physics_fault", "contact_overflow", "layout_invalid")
DOING = ("on top of something", "holding something", "neither")
"""What any agent of a world does before a step; the first that is true."""
GAME = "hide_and_seek"
"""What is played without `env` and `policy`."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: environment, by name; without one, the policy's own, or `hide_and_seek`.
        impl: engine.
        worlds: batch size.
        physics_steps: how many in all, of all worlds and runs.
        policy: a trained policy, by name or file, or the folder of its run, that plays in the place of hostile agents.
        held: for how many env steps a hostile force is held.
        chunk: env steps of a rollout.
        every: rollouts between checkpoints.
        folder: of the checkpoints, with each of which `out` is written; a later run with the same goes on from the
            last.
    """

    env: str | None = None
    impl: Impl = "warp"
    worlds: PositiveCount = 16_384
    physics_steps: float = 1e9
    policy: str | None = None
    held: PositiveCount = 20
    chunk: PositiveCount = 100
    every: PositiveCount = 10
    folder: Path = Path("soak")


class Tally(struct.PyTreeNode):
    """Counts of what was seen so far.

    Attributes:
        env_steps: () int32, of each world.
        bad_steps: () int32, steps after which some number that a user sees was not finite.
        doing: (3,) float32 env steps of all worlds, by `DOING`.
        faults: (3,) float32, which of them had a fault.
        counts: (4,) float32 totals of all worlds before `states.counts`, which begin at 0 in every rollout,
            since they are int32: by `COUNTS`.
        seconds: () float32 that rollouts took.
    """

    env_steps: jax.Array
    bad_steps: jax.Array
    doing: jax.Array
    faults: jax.Array
    counts: jax.Array
    seconds: jax.Array

    @classmethod
    def nothing(cls) -> Tally:
        """The tally before the first step."""
        none = jnp.zeros((), jnp.int32)
        by_doing = jnp.zeros(len(DOING))
        return cls(none, none, by_doing, by_doing, jnp.zeros(len(COUNTS)), jnp.zeros(()))


@dataclass(frozen=True)
class Row(Measured):
    """Figures of all runs together; `measured` is the last one.

    Attributes:
        policy: who played; empty if hostile agents did.
        by_doing: physics steps and faults of each of `DOING`; none in files from before they were counted.
    """

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
    policy: str = ""
    by_doing: dict[str, dict[str, float]] = field(default_factory=dict)


def game_of(config: Config) -> tuple[maax.Environment, training.Policy | None]:
    """Returns what is played, and the policy as it plays it."""
    if config.policy is None:
        return maax.make(config.env or GAME, impl=config.impl), None
    policy = training.Policy.load(config.policy)
    env = maax.make(config.env, impl=config.impl) if config.env else policy.make_env(impl=config.impl)
    return env, policy.on(env)


def hostile(env: maax.Environment, worlds: int, key: jax.Array) -> dict[str, jax.Array]:
    """Actions of full force one way or the other, with everything locked and grabbed."""
    spaces = env.action_space.spaces
    action = {name: jnp.ones((worlds, *space.shape), jnp.int8) for name, space in spaces.items() if name != "move"}  # type: ignore[misc]
    forwards = jax.random.bernoulli(key, shape=(worlds, env.base.n_agents, 3))
    bins = getattr(spaces["move"], "nvec", None)
    most, least = (1.0, -1.0) if bins is None else (int(bins.flat[0]) - 1, 0)
    return {**action, "move": jnp.where(forwards, most, least)}


def doing(env: maax.Environment, states: WorldsState) -> jax.Array:
    """Returns (n_worlds, 3) bool, which of `DOING` holds in each world."""
    agents, grabs = env.base.agents, find(env, GrabObjects)
    there = states.world.active[agents.kind]
    up = ((states.data.xpos[:, agents.body_ids, 2] > HIGH) & there).any(axis=1)
    holds = (states.mechanics[grabs.name].held >= 0).any(axis=1) if grabs is not None else jnp.zeros_like(up)
    return jnp.stack([up, holds & ~up, ~holds & ~up], axis=1)


def player(
    worlds: maax.Worlds, policy: training.Policy | None, held: int, chunk: int
) -> Callable[[WorldsState, Any, Tally, Any], tuple[WorldsState, Any, Tally]]:
    """Compiled `(states, memory, tally, params) -> states, memory, tally`: a chunk of steps, counted."""

    def act(states: WorldsState, memory: Any, params: Any, t: jax.Array) -> tuple[Any, Any]:
        if policy is None:
            return hostile(worlds.env, worlds.n_worlds, jax.random.fold_in(jax.random.key(1), t // held)), memory
        keys = jax.random.split(jax.random.fold_in(jax.random.key(1), t), worlds.n_worlds)
        return jax.vmap(policy.play, (0, 0, 0, None))(states, keys, memory, params)

    def play(states: WorldsState, memory: Any, tally: Tally, params: Any) -> tuple[WorldsState, Any, Tally]:
        def step(carry: tuple[WorldsState, Any, Tally], _: None) -> tuple[tuple[WorldsState, Any, Tally], None]:
            states, memory, tally = carry
            did = doing(worlds.env, states)
            action, memory = act(states, memory, params, tally.env_steps)
            states = worlds.step_fn(states, action)
            public = states.replace(upcoming=(), data=states.data.replace(engine=()))
            floats = [x for x in jax.tree.leaves(public) if jnp.issubdtype(x.dtype, jnp.floating)]
            faulted = states.metrics["physics_fault"] > 0
            tally = tally.replace(
                env_steps=tally.env_steps + 1,
                bad_steps=tally.bad_steps + ~jnp.stack([jnp.isfinite(x).all() for x in floats]).all(),
                doing=tally.doing + did.sum(axis=0),
                faults=tally.faults + (did & faulted[:, None]).sum(axis=0),
            )
            return (states, forgotten(memory, states.done), tally), None

        return jax.lax.scan(step, (states, memory, tally), length=chunk)[0]

    return jax.jit(play, donate_argnums=(0, 1))


def main(config: Config) -> None:
    """Goes on until all steps are done or the minutes are over."""
    config.check()
    run = record.run_of(config)
    env, policy = game_of(config)
    worlds = maax.Worlds(env, config.worlds)
    memory: Any = () if policy is None else jnp.asarray(policy.memory(config.worlds))
    params = () if policy is None else policy.params
    checkpoints, tally, runs = maax.Checkpoints(config.folder), Tally.nothing(), 1
    play = player(worlds, policy, config.held, config.chunk)
    if checkpoints.latest is None:
        states = worlds.reset(jax.random.key(0), stagger=True)
    else:
        states, others = checkpoints.restore(worlds, tally=tally, memory=memory, runs=jnp.ones((), jnp.int32))
        tally, memory, runs = others["tally"], others["memory"], int(others["runs"]) + 1
    per_step = config.worlds * env.base.n_frames
    begun, chunks = time.monotonic(), 0
    total, done = int(config.physics_steps), int(tally.env_steps) * per_step
    with progress(None, "soak", total=total, initial=done, unit_scale=True) as bar:
        while bar.n < config.physics_steps and not _over(begun, config.max_minutes):
            start = time.perf_counter()
            states, memory, tally = jax.block_until_ready(play(states, memory, tally, params))
            chunks += 1
            # The first one compiles.
            seconds = time.perf_counter() - start if chunks > 1 else 0.0
            counts = jnp.array([states.totals()[name] for name in COUNTS], jnp.float32)
            states = states.replace(counts=jax.tree.map(jnp.zeros_like, states.counts))
            tally = tally.replace(counts=tally.counts + counts, seconds=tally.seconds + seconds)
            bar.update(config.chunk * per_step)
            done = bar.n >= config.physics_steps or _over(begun, config.max_minutes)
            if done or chunks % config.every == 0:
                others = {"tally": tally, "memory": memory, "runs": jnp.asarray(runs)}
                checkpoints.save(int(tally.env_steps), worlds, states, **others)
                record.write(config.out, [replace(row_of(tally, config, env, runs), measured=run)])
    print(row_of(tally, config, env, runs), flush=True)


def row_of(tally: Tally, config: Config, env: maax.Environment, runs: int) -> Row:
    """The tally as a row."""
    steps, n_frames = int(tally.env_steps) * config.worlds, env.base.n_frames
    counts = dict(zip(COUNTS, (int(x) for x in tally.counts), strict=True))
    timed = steps - runs * config.chunk * config.worlds

    by_doing = {}
    for name, env_steps, faults in zip(DOING, tally.doing, tally.faults, strict=True):
        physics, faulted = int(env_steps) * n_frames, int(faults)
        figures = {"physics_steps": physics, "faults": faulted}
        by_doing[name] = figures | {"faults_per_million_physics_steps": per_million(faulted, physics)}
    return Row(
        env=config.env or (env.made_from.name if env.made_from else GAME),
        impl=config.impl,
        worlds=config.worlds,
        policy=config.policy or "",
        held=0 if config.policy else config.held,
        n_frames=n_frames,
        env_steps=steps,
        physics_steps=steps * n_frames,
        steps_with_nan=int(tally.bad_steps),
        episodes=counts["episodes"],
        physics_faults=counts["physics_fault"],
        contact_overflows=counts["contact_overflow"],
        layouts_invalid=counts["layout_invalid"],
        faults_per_million_physics_steps=per_million(counts["physics_fault"], steps * n_frames),
        physics_steps_per_s=round(timed * n_frames / float(tally.seconds)) if float(tally.seconds) else 0,
        runs=runs,
        by_doing=by_doing,
    )


def per_million(faults: int, physics_steps: int) -> float:
    """Returns faults in a million physics steps."""
    return round(faults / max(physics_steps, 1) * 1e6, 4)


def _over(begun: float, minutes: float | None) -> bool:
    return minutes is not None and time.monotonic() - begun > 60 * minutes


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
