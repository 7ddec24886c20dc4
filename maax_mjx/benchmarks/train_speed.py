"""Env steps per second of training, beside those of the environment alone and of play without learning.

`env` steps the worlds under random actions that are redrawn at every step; `play` lets untrained networks act and
judge, and keeps what they would learn from; `train` makes whole iterations. All step the same worlds, `ppo.unroll`
steps in a turn, episodes begun at different times. What agents learn can make the physics dearer: `--policy` begins
from a trained one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.stepping import draw_actions, env_roll
from maax_mjx.common.annotated import OneOf, PositiveCount
from maax_mjx.training.begin import taken_over
from maax_mjx.training.collect import Remembered, collect
from maax_mjx.training.config import PRESETS, TrainConfig
from maax_mjx.training.learner import compile_iteration, new_learner
from maax_mjx.training.network import Network

PARTS = ("env", "play", "train")


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: games to time, by name.
        impl: engines.
        worlds: batch sizes, of all devices together.
        devices: how many; with several, the environment alone is left out, which `bench devices` times.
        part: what to time.
        encoder: of the networks.
        core: memory of the networks.
        compute: types of the networks' layers.
        epochs: times that every step is used.
        minibatches: updates per epoch.
        microbatches: parts of a minibatch, one after another.
        preset: the other settings.
        policy: a trained policy, by name or file, or the folder of its run, to play and train on with; its networks
            decide the encoder and the memory.
        turns: timed turns of `ppo.unroll` steps.
    """

    env: tuple[str, ...] = ("hide_and_seek_quadrant",)
    impl: tuple[Impl, ...] = ("auto",)
    worlds: tuple[PositiveCount, ...] = (1024,)
    devices: tuple[PositiveCount, ...] = (1,)
    part: tuple[Annotated[str, OneOf(PARTS)], ...] = PARTS
    encoder: tuple[Annotated[str, OneOf(("flat", "pool", "attend"))], ...] = ("pool",)
    core: tuple[Annotated[str, OneOf(("none", "gru", "lstm"))], ...] = ("lstm",)
    compute: tuple[Annotated[str, OneOf(("float32", "bfloat16"))], ...] = ("float32",)
    epochs: tuple[PositiveCount, ...] = (2,)
    minibatches: tuple[PositiveCount, ...] = (16,)
    microbatches: tuple[PositiveCount, ...] = (1,)
    preset: Annotated[str, OneOf(tuple(PRESETS))] = "gpu"
    policy: Path | None = None
    turns: PositiveCount = 4


@dataclass(frozen=True)
class Case:
    """One measurement; the settings of networks and updates are "" and 0 where the part has none.

    Attributes:
        policy: the one that plays, as it was given; "" for untrained networks.
    """

    env: str
    impl: str
    worlds: int
    part: str
    encoder: str
    core: str
    compute: str
    epochs: int
    minibatches: int
    turns: int
    devices: int = field(default=1, kw_only=True)
    microbatches: int = field(default=1, kw_only=True)
    policy: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case in env steps per second, all worlds added.

    Attributes:
        unroll: env steps of every world in a turn.
        env_steps_per_s: of all turns together.
        fastest: env steps per second of the fastest turn.
        compile_s: the first turn's seconds, compilation included.
        physics_faults: over all turns.
        peak_bytes: the most that JAX's pool ever had in use in this process; None where the device does not count.
    """

    unroll: int
    env_steps_per_s: float
    fastest: float
    compile_s: float
    physics_faults: int
    peak_bytes: int | None


def cases(config: Config) -> Iterator[Case]:
    """Cases, those of one batch after another; what a part does not have is not varied."""
    seen = set()
    encoders, cores, policy = config.encoder, config.core, ""
    if config.policy is not None:
        learnt, policy = training.Policy.load(config.policy).network.net, str(config.policy)
        encoders, cores = (learnt.encoder,), (learnt.core,)
    for env, impl, n, devices in product(config.env, config.impl, config.worlds, config.devices):
        varied = (encoders, cores, config.compute, config.epochs, config.minibatches, config.microbatches)
        nets = product(*varied)
        for net, part in product(list(nets), config.part):
            encoder, core, compute, epochs, minibatches, microbatches = net
            settings = (encoder, core, compute, epochs, minibatches, config.turns)
            case = Case(env, impl, n, part, *settings, devices=devices, microbatches=microbatches, policy=policy)
            if part == "env" and devices > 1:
                continue
            if part != "train":
                case = replace(case, epochs=0, minibatches=0, microbatches=1)
            if part == "env":
                case = replace(case, encoder="", core="", compute="", policy="")
            if case not in seen:
                seen.add(case)
                yield case


@lru_cache(maxsize=1)
def worlds_of(env: str, impl: str, n: int, preset: str, devices: int) -> maax.Worlds:
    """The worlds of a game, with the preset's fields of its config."""
    return maax.Worlds(training.environment_of(env, training.preset(preset), {"impl": impl}), n, devices)


Turn = Callable[[int, Any], Any]
"""`(i, carry) -> carry`, whose first entry is the worlds' states."""


def measure(case: Case, config: Config) -> Row:
    """Times turns."""
    worlds = worlds_of(case.env, case.impl, case.worlds, config.preset, case.devices)
    settings: dict[str, Any] = {"worlds": case.worlds}
    if case.part != "env":
        settings |= {"net.encoder": case.encoder, "net.core": case.core, "net.compute": case.compute}
    if case.part == "train":
        settings |= {f"ppo.{name}": getattr(case, name) for name in ("epochs", "minibatches", "microbatches")}
    chosen = training.preset(config.preset, settings)
    turn, carry = {"env": stepped, "play": played, "train": trained}[case.part](worlds, chosen, config.policy)
    begun = time.perf_counter()
    carry = jax.block_until_ready(turn(0, carry))
    compile_s = time.perf_counter() - begun
    spent = []
    for i in range(1, case.turns + 1):
        begun = time.perf_counter()
        carry = jax.block_until_ready(turn(i, carry))
        spent.append(time.perf_counter() - begun)
    taken = case.worlds * chosen.ppo.unroll
    return Row(
        **vars(case),
        unroll=chosen.ppo.unroll,
        env_steps_per_s=round(taken * len(spent) / sum(spent)),
        fastest=round(taken / min(spent)),
        compile_s=round(compile_s, 1),
        physics_faults=carry[0].totals()["physics_fault"],
        peak_bytes=(jax.local_devices()[0].memory_stats() or {}).get("peak_bytes_in_use"),
    )


def stepped(worlds: maax.Worlds, config: TrainConfig, policy: Path | None) -> tuple[Turn, Any]:
    """The environment alone."""
    roll, actions = env_roll(worlds), draw_actions(worlds.env, worlds.n_worlds, 1)
    steps = jnp.arange(config.ppo.unroll)

    def turn(i: int, carry: Any) -> Any:
        return (roll(carry[0], actions, steps + i * config.ppo.unroll, 1),)

    return turn, (worlds.reset(jax.random.key(0), stagger=True),)


def played(worlds: maax.Worlds, config: TrainConfig, policy: Path | None) -> tuple[Turn, Any]:
    """What an iteration does before it learns."""
    network, weights = networks(worlds, config, policy)

    def play(index: jax.Array, weights: Any, key: jax.Array, states: Any, memory: Any) -> Any:
        states, memory, batch, _ = collect(worlds, network, weights, None, index, states, memory, key, config.ppo)
        # All of the batch is needed, or it would not be computed.
        return states, memory, jax.tree.map(lambda x: x.astype(jnp.float32).mean(), batch)

    run = worlds.shards.compile(play, (None, None, 0, 0), out_axes=(0, 0, None), donate=(2, 3))
    weights = worlds.shards.replicate(weights)

    def turn(i: int, carry: Any) -> Any:
        return worlds.run(run, weights, jax.random.key(i), *carry)[:2]

    return turn, begun(worlds, network)


def trained(worlds: maax.Worlds, config: TrainConfig, policy: Path | None) -> tuple[Turn, Any]:
    """Whole iterations."""
    network, weights = networks(worlds, config, policy)
    run = compile_iteration(worlds, network, config)
    learner = worlds.shards.replicate(new_learner(weights, config))

    def turn(i: int, carry: Any) -> Any:
        states, memory, learner = carry
        learner, states, memory, _ = worlds.run(run, learner, None, jax.random.key(i), states, memory)
        return states, memory, learner

    return turn, (*begun(worlds, network), learner)


def networks(worlds: maax.Worlds, config: TrainConfig, policy: Path | None) -> tuple[Network, Any]:
    """The networks and their weights, untrained without a policy; a critic that it lacks is untrained."""
    if policy is None:
        network = Network.of(worlds.env, config.net)
        return network, network.draw(jax.random.key(1))
    found = training.Policy.load(policy).on(worlds.env)
    network = replace(found.network, net=replace(found.network.net, compute=config.net.compute))
    return network, taken_over(found, network, jax.random.key(1))


def begun(worlds: maax.Worlds, network: Network) -> tuple[Any, Any]:
    """States and memories at the beginning."""
    memory = Remembered(network.memory(worlds.n_worlds), ())
    return worlds.reset(jax.random.key(0), stagger=True), worlds.shards.put(jax.tree.map(jax.device_get, memory))


HEADER = (
    "env                    impl   worlds on  part  encoder core compute  epochs  parts      env/s   fastest  compile"
)


def line(row: Row) -> str:
    """A row of the table."""
    return (
        f"{row.env:22} {row.impl:5} {row.worlds:7} {row.devices:2} {row.part:>5} {row.encoder:7} {row.core:4} "
        f"{row.compute:8} {row.epochs:6} {row.minibatches:3}x{row.microbatches:<2} {row.env_steps_per_s:10,.0f} "
        f"{row.fastest:9,.0f} {row.compile_s:8.1f}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
