"""How worlds of the published games begin, beside the published rules: counts, rooms, doors, places and doorways.

Worlds of `maax.make(game, published=True)` are compared with twice as many of a second implementation in NumPy, which
was written from a description of the published code: by two-sample Kolmogorov-Smirnov tests, and by chi-square tests of
counts. Where both have the same distributions, one p-value of a hundred is below 0.01.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import jax
import numpy as np
from scipy import stats

import maax_mjx as maax
from maax_mjx.benchmarks import published_oracle as oracle
from maax_mjx.benchmarks.bench import Impl, Options, benchmark
from maax_mjx.benchmarks.published_oracle import CELL, FULL, QUADRANT, Starts
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, OneOf, PositiveCount
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State

BATCH = 500
"""Worlds that begin at a time."""
FEW = 300
"""Worlds of the oracle that have every statistic."""


@dataclass
class Config(Options):
    """Options.

    Attributes:
        env: published games.
        worlds: of ours, a multiple of 500; the oracle draws twice as many.
        seed: of both.
        impl: engine, which does not move anything here.
    """

    env: tuple[Annotated[str, OneOf((QUADRANT, FULL))], ...] = (QUADRANT, FULL)
    worlds: PositiveCount = 4000
    seed: Count = 0
    impl: Impl = "auto"

    def check(self) -> None:
        super().check()
        if self.worlds % BATCH:
            raise ValueError(f"worlds: got {self.worlds}; takes a multiple of {BATCH}")


@dataclass(frozen=True)
class Case:
    """One statistic of a game."""

    env: str
    statistic: str
    worlds: int
    seed: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A statistic of both.

    Attributes:
        n, n_published: worlds that have it.
        mean, mean_published: means, in metres, cells, or numbers of things; of truths the share.
        p: that both are draws from one distribution.
        test: "ks" or "chi2".
    """

    n: int
    n_published: int
    mean: float
    mean_published: float
    p: float
    test: str


def starts(env: Environment, game: str, n: int, key: jax.Array) -> Starts:
    """How worlds of ours begin.

    Args:
        env: a published game.
        game: its name.
        n: worlds, a multiple of 500.
        key: random key.
    """

    @jax.jit
    @jax.vmap
    def begin(key: jax.Array) -> tuple[Any, ...]:
        state: State = env.reset(key)
        return state.world.plan, state.world.active, state.world.extents, state.data.qpos, state.world.valid

    parts = [jax.device_get(begin(some)) for some in jax.random.split(key, (n // BATCH, BATCH))]
    plan, active, extents, qpos, valid = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    assert valid.all()
    boxes = extents["box"][..., :2] if "box" in extents else np.full((n, 2, 2), oracle.CUBE)
    corners = {}
    for name, size in (("agent", oracle.AGENT), ("box", boxes), ("ramp", oracle.RAMP)):
        centre = qpos[:, env.base.modules[name].qpos_ids[:, :2]]  # type: ignore[attr-defined]
        corners[name] = np.where(active[name][..., None], centre - np.asarray(size) / 2, np.nan)
    boxes = np.where(active["box"][..., None], boxes, np.nan)
    if game == FULL:
        area = (plan.rooms[..., 2:] - plan.rooms[..., :2]).prod(axis=-1)
        areas = np.sort(np.where(plan.room_mask, area, np.nan), axis=1)
    else:
        areas = np.tile([[14 * 13, 28 * 28 - 15 * 15 + 1.0, np.nan, np.nan]], (n, 1))
    return Starts(game, plan.closed, areas, doorways(plan), **corners, sizes=boxes)


def doorways(plan: Any) -> np.ndarray:
    """First and last cells of doors, from the middles of their openings in metres: these lie on the line of a wall."""
    at = plan.doors[..., :2] / CELL
    across = np.abs(at - np.floor(at) - 0.5) < 1e-3
    assert (across.sum(axis=-1) == 1)[plan.door_mask].all()
    first = np.where(across, np.floor(at), np.round(at) - oracle.DOOR / 2)
    last = np.where(across, np.floor(at), np.round(at) + oracle.DOOR / 2 - 1)
    return np.where(plan.door_mask[..., None], np.concatenate([first, last], axis=-1), np.nan)


def p_value(ours: np.ndarray, theirs: np.ndarray) -> float:
    """That two samples are of one distribution."""
    if not is_counted(ours):
        return float(stats.ks_2samp(ours, theirs).pvalue)
    values = np.union1d(ours, theirs)
    table = [(sample[:, None] == values).sum(axis=0) for sample in (ours, theirs)]
    return float(stats.chi2_contingency(table).pvalue) if len(values) > 1 else 1.0


def is_counted(sample: np.ndarray) -> bool:
    """Whether a sample is of counts or truths."""
    return np.issubdtype(sample.dtype, np.integer)


@lru_cache(maxsize=1)
def sampled(game: str, worlds: int, seed: int, impl: str) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """All statistics of a game: ours, and the oracle's."""
    ours = starts(maax.make(game, impl=impl, published=True), game, worlds, jax.random.key(seed))
    theirs = oracle.starts(np.random.default_rng(seed), game, 2 * worlds)
    return oracle.statistics(ours), oracle.statistics(theirs)


def cases(config: Config) -> Iterator[Case]:
    """Cases, all statistics of a game before the next."""
    for game in config.env:
        for name in oracle.statistics(oracle.starts(np.random.default_rng(0), game, FEW)):
            yield Case(game, name, config.worlds, config.seed)


def measure(case: Case, config: Config) -> Row:
    """Compares one statistic."""
    ours, theirs = (found[case.statistic] for found in sampled(case.env, case.worlds, case.seed, config.impl))
    return Row(
        **vars(case),
        n=len(ours),
        n_published=len(theirs),
        mean=round(float(ours.mean()), 4),
        mean_published=round(float(theirs.mean()), 4),
        p=float(f"{p_value(ours, theirs):.3g}"),
        test="chi2" if is_counted(ours) else "ks",
    )


HEADER = f"{'game':24}{'statistic':30}{'worlds':>8}{'ours':>10}{'published':>11}{'p':>10}"


def line(row: Row) -> str:
    """A row of the table."""
    return f"{row.env:24}{row.statistic:30}{row.n:8,}{row.mean:10.3f}{row.mean_published:11.3f}{row.p:10.3g}"


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
