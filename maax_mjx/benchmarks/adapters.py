"""What adapters cost: env steps per second through each of them, beside those of `Worlds`, in one run.

`rollout` is one compiled program of all steps, `step` a call of `Worlds.step` for each, both with actions that are
drawn on the device at every step. The batches of other libraries hold one action that was drawn before. `pettingzoo`
has one world and draws actions. `jaxmarl`, `brax` and `playground` are their own loops of `step` in their own wrappers,
compiled as a whole, with agents that stand still.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Annotated, Any

import jax
import jax.numpy as jnp
from gymnasium.vector.utils import batch_space

import maax_mjx as maax
from maax_mjx import adapters
from maax_mjx.adapters.agents import PerAgent
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import OneOf, PositiveCount

WAYS = (
    "rollout",
    "step",
    "gymnasium_vector",
    "stable_baselines3",
    "torch",
    "jaxmarl",
    "brax",
    "playground",
    "pettingzoo",
)


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: games, by name; "jaxmarl" and "stable_baselines3" take those of one kind of action.
        impl: engines.
        worlds: batch sizes.
        way: adapters, "rollout" and "step".
        steps: env steps of every world that are timed.
    """

    env: tuple[str, ...] = ("tag",)
    impl: tuple[Impl, ...] = ("c",)
    worlds: tuple[PositiveCount, ...] = (64, 1024)
    way: tuple[Annotated[str, OneOf(WAYS)], ...] = WAYS
    steps: PositiveCount = 200


@dataclass(frozen=True)
class Case:
    """One way to step one batch."""

    env: str
    impl: str
    worlds: int
    way: str


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case in env steps per second, all worlds added; `ratio` is over `rollout` of the same batch."""

    env_steps_per_s: float
    ratio: float


def cases(config: Config) -> Iterator[Case]:
    """Cases; one world is stepped once, whatever the batches."""
    seen = set()
    for env, impl, n, way in product(config.env, config.impl, config.worlds, config.way):
        case = Case(env, impl, 1 if way == "pettingzoo" else n, way)
        if case not in seen:
            seen.add(case)
            yield case


def stepper(case: Case, n_steps: int) -> Callable[[], Any]:
    """Returns a function that makes so many steps of all worlds, and returns something of their end."""
    env = maax.make(case.env, impl=case.impl)
    if case.way == "pettingzoo":
        return _pettingzoo(env, n_steps)
    if case.way == "jaxmarl":
        return _jaxmarl(env, case.worlds, n_steps)
    if case.way in ("brax", "playground"):
        return _single(env, case.way, case.worlds, n_steps)
    worlds = maax.Worlds(env, case.worlds)
    if case.way in ("rollout", "step"):
        return _worlds(worlds, case.way, n_steps)
    agents = getattr(adapters, case.way)(worlds)
    agents.reset()
    action = batch_space(PerAgent(env).action_space, case.worlds * env.n_agents).sample()
    if case.way == "torch":
        import torch

        action = torch.as_tensor(action, device=agents.device)

    def run() -> Any:
        for _ in range(n_steps):
            last = agents.step(action)
        return last.reward.sum().item() if case.way == "torch" else None

    return run


def _worlds(worlds: maax.Worlds, way: str, n_steps: int) -> Callable[[], Any]:
    env, kept = worlds.env, [worlds.reset(jax.random.key(0), stagger=True)]

    def policy(state: maax.State, key: jax.Array) -> Any:
        return env.sample_action(key)

    def run() -> Any:
        if way == "rollout":
            kept[0], _ = worlds.rollout(kept[0], policy, n_steps)
        else:
            for i in range(n_steps):
                kept[0] = worlds.step(kept[0], worlds.sample_action(jax.random.key(i)))
        return jax.block_until_ready(kept[0].reward)

    return run


def _jaxmarl(env: maax.Environment, n_worlds: int, n_steps: int) -> Callable[[], Any]:
    game = adapters.jaxmarl(env)
    keys = jax.random.split(jax.random.PRNGKey(0), n_worlds)
    first = jax.jit(jax.vmap(game.reset))(keys)[1]
    action = {agent: jnp.zeros((n_worlds, *game.action_space(agent).shape)) for agent in game.agents}

    def one(state: Any, i: jax.Array) -> tuple[Any, jax.Array]:
        _, state, reward, *_ = jax.vmap(game.step)(jax.vmap(jax.random.fold_in, (0, None))(keys, i), state, action)
        return state, reward[game.agents[0]].sum()

    loop = jax.jit(lambda state: jax.lax.scan(one, state, jnp.arange(n_steps)))
    return lambda: jax.block_until_ready(loop(first)[1])


def _single(env: maax.Environment, way: str, n_worlds: int, n_steps: int) -> Callable[[], Any]:
    game, horizon = getattr(adapters, way)(env), env.base.horizon
    if way == "brax":
        from brax.envs.wrappers.training import wrap

        batch = wrap(game, episode_length=horizon)
    else:
        from mujoco_playground import wrapper

        batch = wrapper.wrap_for_brax_training(game, episode_length=horizon)
    first = jax.jit(batch.reset)(jax.random.split(jax.random.PRNGKey(0), n_worlds))
    action = jnp.zeros((n_worlds, game.action_size))

    def one(state: Any, _: None) -> tuple[Any, jax.Array]:
        state = batch.step(state, action)
        return state, state.reward.sum()

    loop = jax.jit(lambda state: jax.lax.scan(one, state, length=n_steps))
    return lambda: jax.block_until_ready(loop(first)[1])


def _pettingzoo(env: maax.Environment, n_steps: int) -> Callable[[], Any]:
    world = adapters.pettingzoo(env)

    def run() -> None:
        for _ in range(n_steps):
            if not world.agents:
                world.reset()
            world.step({agent: world.action_space(agent).sample() for agent in world.agents})

    return run


@lru_cache(maxsize=64)
def speed_of(case: Case, n_steps: int) -> float:
    """Env steps per second, of the second run: the first one compiles."""
    run = stepper(case, n_steps)
    run()
    start = time.perf_counter()
    run()
    return case.worlds * n_steps / (time.perf_counter() - start)


def measure(case: Case, config: Config) -> Row:
    """Times a way, and the compiled rollout of the same batch once for all of its ways."""
    speed = speed_of(case, config.steps)
    alone = speed_of(Case(case.env, case.impl, case.worlds, "rollout"), config.steps)
    return Row(**vars(case), env_steps_per_s=round(speed), ratio=round(speed / alone, 3))


HEADER = "env                    impl   worlds  way                     env/s  ratio"


def line(row: Row) -> str:
    """A row of the table."""
    return f"{row.env:22} {row.impl:5} {row.worlds:7} {row.way:18} {row.env_steps_per_s:10,.0f} {row.ratio:6.2f}"


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
