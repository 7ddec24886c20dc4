"""What memories know of objects that are out of sight: a head learns to read from them how many went to the left.

As in Baker et al.'s counting task: policies watch `object_counting` with frozen weights, and a linear classifier is
trained on their memories, beside one on those of networks with random weights. `chance` is the share of the most
frequent answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

import maax_mjx as maax
from maax_mjx import training
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, Positive, PositiveCount
from maax_mjx.core.env import Environment
from maax_mjx.training.begin import taken_over
from maax_mjx.training.network import Network
from maax_mjx.training.policy import Play
from maax_mjx.training.ratings import LIKELY
from maax_mjx.wrappers import ObjectCounting
from maax_mjx.wrappers.wrapper import find

GAME, RANDOM = "object_counting", "random"
ASKED = (70, 80, 90, 100, 110, 118)
"""Env steps after which it is asked; from the 65th on nothing is seen."""
BATCH = 512
"""Worlds at a time: the memories of all their steps are kept."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        begin: whose memories: policies of `training.policies()` or their files, or "random" weights.
        seeds: of the worlds, the random weights and the classifiers.
        worlds: that a classifier learns from; as many others test it. A multiple of 512, or less.
        updates: of a classifier.
        lr: its learning rate.
        decay: weight of its squared weights.
        impl: engine.
    """

    begin: tuple[str, ...] = (RANDOM, "quadrant/chase", "quadrant/forts", "quadrant/ramps")
    seeds: tuple[Count, ...] = (0, 1, 2)
    worlds: PositiveCount = 4096
    updates: PositiveCount = 500
    lr: Positive = 3e-3
    decay: Positive = 1e-3
    impl: Impl = "auto"

    def check(self) -> None:
        super().check()
        if self.worlds > BATCH and self.worlds % BATCH:
            raise ValueError(f"worlds: got {self.worlds}; takes a multiple of {BATCH}, or less")


@dataclass(frozen=True)
class Case:
    """One classifier."""

    begin: str
    seed: int
    worlds: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """How well it answers in worlds that it has not seen. Margins are half the widths of 95 % intervals.

    Attributes:
        accuracy, margin: share of right answers, of all steps at which it is asked.
        by_step: the same, by the env steps.
        off: mean distance of the answer from the number.
        chance: share of the most frequent answer.
    """

    accuracy: float
    margin: float
    by_step: dict[str, float]
    off: float
    chance: float


def cases(config: Config) -> Iterator[Case]:
    """Cases, all memories with one seed before the next seed."""
    for seed, begin in product(config.seeds, config.begin):
        yield Case(begin, seed, config.worlds)


@lru_cache(maxsize=1)
def game(impl: str) -> Environment:
    """The task, as the policies of the quadrant observe."""
    return maax.make(GAME, impl=impl, observations="ego", observe="all")


def watcher(case: Case, env: Environment) -> tuple[Network, Any]:
    """The network that watches, and its weights: what a policy and the task have in common by name, and its memory."""
    key = jax.random.key(case.seed)
    if case.begin == RANDOM:
        network = Network.of(env, training.preset("gpu").net)
        return network, network.draw(key)
    policy = training.Policy.load(case.begin)
    network = Network.of(env, policy.network.net)
    return network, taken_over(policy, network, key, transfer=True)


@lru_cache(maxsize=1)
def compiled(impl: str, network: Network, n_worlds: int) -> tuple[maax.Worlds, Callable[..., Any]]:
    """Worlds and the policy that watches them; networks of other weights are the same program."""
    env = game(impl)
    play, task = Play(network), find(env, ObjectCounting)
    assert task is not None

    def watch(state: Any, key: jax.Array, memory: jax.Array, weights: Any) -> tuple[Any, jax.Array, dict[str, Any]]:
        action, after = play(state, key, memory, weights)
        return action, after, {"memory": after[0], "left": task.counts(state)[0]}

    return maax.Worlds(env, n_worlds), watch


def watched(case: Case, config: Config) -> tuple[np.ndarray, np.ndarray]:
    """Memories (2 n_worlds, len(ASKED), m), and how many boxes went to the left (2 n_worlds,)."""
    network, weights = watcher(case, game(config.impl))
    n = min(case.worlds, BATCH)
    worlds, watch = compiled(config.impl, network, n)
    memories, lefts = [], []
    for i in range(2 * case.worlds // n):
        key = jax.random.fold_in(jax.random.key(case.seed), i)
        memory = np.zeros(jax.eval_shape(lambda: network.memory(n).actor).shape, np.float32)
        states, keep = worlds.reset(key), ("extras",)
        _, kept = worlds.rollout(states, watch, max(ASKED) + 1, weights, key=key, keep=keep, memory=memory)
        memories.append(np.swapaxes(np.asarray(kept["extras"]["memory"])[np.asarray(ASKED)], 0, 1))
        lefts.append(np.asarray(kept["extras"]["left"])[0])
    return np.concatenate(memories), np.concatenate(lefts)


@jax.jit
def _loss(head: dict[str, jax.Array], x: jax.Array, y: jax.Array, decay: jax.Array) -> jax.Array:
    logits = x @ head["kernel"] + head["bias"]
    return optax.softmax_cross_entropy_with_integer_labels(logits, y).mean() + decay * (head["kernel"] ** 2).sum()


def classifier(x: np.ndarray, y: np.ndarray, n_classes: int, config: Config) -> dict[str, Any]:
    """A linear classifier of memories (n, m), trained on all of them at once."""
    optimiser = optax.adam(config.lr)
    head = {"kernel": jnp.zeros((x.shape[1], n_classes)), "bias": jnp.zeros(n_classes)}

    @jax.jit
    def train(head: dict[str, Any], x: jax.Array, y: jax.Array) -> dict[str, Any]:
        def update(carry: Any, _: None) -> tuple[Any, None]:
            head, moments = carry
            change, moments = optimiser.update(jax.grad(_loss)(head, x, y, config.decay), moments)
            return (optax.apply_updates(head, change), moments), None

        return jax.lax.scan(update, (head, optimiser.init(head)), length=config.updates)[0][0]

    return jax.device_get(train(head, jnp.asarray(x), jnp.asarray(y)))


def measure(case: Case, config: Config) -> Row:
    """Watches, trains a classifier on one half of the worlds and tests it on the other."""
    memories, left = watched(case, config)
    n, n_asked, width = memories.shape
    mean, std = memories[: n // 2].mean((0, 1)), memories[: n // 2].std((0, 1)) + 1e-3
    x = (memories - mean) / std
    n_classes = 1 + game(config.impl).base.modules["box"].n_max  # type: ignore[attr-defined]
    head = classifier(x[: n // 2].reshape(-1, width), np.repeat(left[: n // 2], n_asked), n_classes, config)
    answers = (x[n // 2 :] @ head["kernel"] + head["bias"]).argmax(-1)
    tested = left[n // 2 :, None]
    right = answers == tested
    each = right.mean(axis=1)
    return Row(
        **vars(case),
        accuracy=round(float(each.mean()), 4),
        margin=round(float(LIKELY * each.std() / len(each) ** 0.5), 4),
        by_step={str(step): round(float(right[:, i].mean()), 4) for i, step in enumerate(ASKED)},
        off=round(float(np.abs(answers - tested).mean()), 4),
        chance=round(float(np.bincount(tested[:, 0], minlength=n_classes).max() / len(tested)), 4),
    )


HEADER = f"begin            seed  worlds   accuracy            off  chance  after {', '.join(map(str, ASKED))} steps"


def line(row: Row) -> str:
    """A row of the table."""
    steps = " ".join(f"{x:.3f}" for x in row.by_step.values())
    return (
        f"{row.begin[-16:]:16} {row.seed:4} {row.worlds:7,}  {row.accuracy:.3f} ± {row.margin:.3f} {row.off:8.3f} "
        f"{row.chance:7.3f}  {steps}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
