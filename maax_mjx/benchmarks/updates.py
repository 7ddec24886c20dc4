"""Time of an update of the networks, by part: on rows that are drawn, without an environment that steps.

It is measured by a profile, see `traces`. On a GPU, XLA joins operations into command buffers, whose parts the profiler
does not see; `XLA_FLAGS=--xla_gpu_enable_command_buffer=` keeps them apart, and makes everything a little slower.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Annotated, Any

import jax
import jax.numpy as jnp

from maax_mjx import training
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.benchmarks.traces import attribute, shares_of, trace
from maax_mjx.common.annotated import OneOf, PositiveCount
from maax_mjx.training.actions import log_prob, sample
from maax_mjx.training.config import TrainConfig
from maax_mjx.training.learner import new_learner
from maax_mjx.training.network import Network
from maax_mjx.training.ppo import Rows, Updates, update

MEMORY, ENTITIES, LAYERS, ROWS, OPTIMISER, REST = "memory", "entities", "layers", "rows", "optimiser", "the rest"
PARTS = (MEMORY, ENTITIES, LAYERS, ROWS, OPTIMISER, REST)
OF_ENTITIES = ("embed", "entities", "norm entities", "queries", "values", "attention", "norm before", "norm after")
"""Beginnings of the names of layers that work on entities."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: games whose observations and actions the networks have.
        rows: chunks of episodes in an epoch; a row has all agents of a world.
        encoder: of the networks.
        core: memory of the networks.
        compute: types of the networks' layers.
        minibatches: updates in an epoch.
        microbatches: parts of a minibatch, one after another.
        chunk: steps of a row.
        preset: the other settings.
    """

    env: tuple[str, ...] = ("hide_and_seek_quadrant",)
    rows: tuple[PositiveCount, ...] = (1024,)
    encoder: tuple[Annotated[str, OneOf(("flat", "pool", "attend"))], ...] = ("pool",)
    core: tuple[Annotated[str, OneOf(("none", "gru", "lstm"))], ...] = ("lstm",)
    compute: tuple[Annotated[str, OneOf(("float32", "bfloat16"))], ...] = ("float32",)
    minibatches: tuple[PositiveCount, ...] = (16,)
    microbatches: tuple[PositiveCount, ...] = (1,)
    chunk: tuple[PositiveCount, ...] = (20,)
    preset: str = "gpu"


@dataclass(frozen=True)
class Case:
    """One measurement."""

    env: str
    rows: int
    encoder: str
    core: str
    compute: str
    minibatches: int
    chunk: int
    microbatches: int = field(default=1, kw_only=True)


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case, times in nanoseconds per step of an agent that is learnt from once.

    Attributes:
        ns: without the profiler, the fastest of three epochs.
        traced_ns: under the profiler.
        parts_ns: by part, what of `traced_ns` its operations took; "unnamed" are operations that no program names,
            "idle" is when none ran.
        temporary_bytes: what the program takes beside its arguments.
        compile_s: compilation.
    """

    ns: float
    traced_ns: float
    parts_ns: dict[str, float]
    temporary_bytes: int
    compile_s: float


def cases(config: Config) -> Iterator[Case]:
    """Combinations of the options."""
    varied = (config.env, config.rows, config.encoder, config.core, config.compute, config.minibatches, config.chunk)
    return (Case(*case, microbatches=n) for n in config.microbatches for case in product(*varied))


def measure(case: Case, config: Config) -> Row:
    """Times and traces the updates of an epoch."""
    nets = {"net.encoder": case.encoder, "net.core": case.core, "net.compute": case.compute}
    # What was drawn is far from what the networks would do: updates go on all the same.
    chosen = training.preset(config.preset, nets | {"ppo.chunk": case.chunk, "ppo.stop_kl": None})
    network = Network.of(training.environment_of(case.env, chosen, None), chosen.net)
    weights = network.draw(jax.random.key(0))
    rows = jax.jit(partial(drawn_rows, network, case.rows, case.chunk))(weights, jax.random.key(1))
    learner = new_learner(weights, chosen)
    now = Updates(learner.weights, learner.moments, jnp.zeros((), bool), learner.broken)
    begun = time.perf_counter()
    epoch = jax.jit(partial(updated, network, chosen, case.minibatches, case.microbatches), donate_argnums=0)
    program = epoch.lower(now, rows, jax.random.key(2)).compile()
    compile_s = time.perf_counter() - begun
    spent = []
    for i in range(4):
        begun = time.perf_counter()
        now = jax.block_until_ready(program(now, rows, jax.random.key(i)))
        spent.append(time.perf_counter() - begun)
    ran = trace(lambda: program(now, rows, jax.random.key(9)))
    parts, window = attribute(ran, shares_of(program.as_text() or "", part_of), part_of, PARTS)
    steps = case.rows * case.chunk * network.n_agents
    memory = program.memory_analysis()
    return Row(
        **vars(case),
        ns=round(min(spent[1:]) / steps * 1e9, 2),
        traced_ns=round(window / steps, 2),
        parts_ns={part: round(t / steps, 2) for part, t in parts.items()},
        temporary_bytes=memory.temp_size_in_bytes if memory else 0,
        compile_s=round(compile_s, 1),
    )


def updated(
    network: Network,
    config: TrainConfig,
    minibatches: int,
    microbatches: int,
    now: Updates,
    rows: Rows,
    key: jax.Array,
) -> Updates:
    """Makes the updates of an epoch."""
    order = jax.random.permutation(key, rows.begins.shape[1]).reshape(minibatches, microbatches, -1)

    def learn(now: Updates, picked: jax.Array) -> tuple[Updates, None]:
        return update(now, network, config.ppo, rows.picked(picked), lambda x: x)[0], None

    return jax.lax.scan(learn, now, order)[0]


def drawn_rows(network: Network, n_rows: int, chunk: int, weights: Any, key: jax.Array) -> Rows:
    """Rows of drawn numbers, and of actions that the networks draw; an episode begins in each."""
    see, act, gain = jax.random.split(key, 3)

    def drawn(shape: jax.ShapeDtypeStruct) -> jax.Array:
        shape_ = (chunk, n_rows, *shape.shape)
        return jax.random.bernoulli(see, 0.6, shape_) if shape.dtype == bool else jax.random.normal(see, shape_)

    features = jax.tree.map(drawn, network.spec.shapes(network.n_agents))
    memory, begins = network.memory(n_rows), jnp.zeros((chunk, n_rows), bool).at[chunk // 2].set(True)
    out, _ = network.actor(weights, features, memory.actor, begins)
    keys = jax.random.split(act, (chunk, n_rows))
    action = jax.vmap(jax.vmap(partial(sample, network.heads)))(out, keys)
    number = jax.random.normal(gain, (chunk, n_rows, network.n_agents))
    every = jnp.ones(number.shape, bool)
    chances = log_prob(network.heads, out, action)
    return Rows(features, action, begins, chances, number, number, every, every, memory)


def part_of(source: str) -> str:
    """The part that an operation belongs to, from the path of scopes it was written in."""
    words = source.split("/")
    if "core" in words:
        return MEMORY
    if any(word.startswith(OF_ENTITIES) for word in words):
        return ENTITIES
    if any("Tower" in word for word in words):
        return LAYERS
    return next((word for word in words if word in (ROWS, OPTIMISER)), REST)


def line(row: Row) -> str:
    """A line about a row, the largest parts first."""
    parts = sorted(row.parts_ns.items(), key=lambda item: -item[1])
    listed = ", ".join(f"{part} {ns / row.traced_ns:.1%}" for part, ns in parts if ns)
    return (
        f"{row.env} {row.rows} x {row.chunk}, {row.encoder} {row.core} {row.compute} "
        f"{row.minibatches} x {row.microbatches}: {row.ns:.1f} ns, {row.traced_ns:.1f} traced: {listed}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line)

if __name__ == "__main__":
    COMMAND.cli()
