"""Time to scatter points that keep apart (thesis figure 4.4).

Three ways get the same tasks: n points at least `radius` apart on a square floor, whose edge grows and n with its area,
or which is filled up. `poisson` is Bridson's algorithm on the host, `darts` is naive rejection on the host with the
same k tries, and `field` is this package's placement on the device: `Layout.place` with `separation_placement`, in one
world and in a batch of worlds that all draw their own. `poisson` always fills the floor and takes n of its points.

The field works on cells: a point lies anywhere in its cell, but that is drawn before the cell is. It finds a place
wherever there is one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np

from maax_mjx.benchmarks import plots, plots_worlds
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import PositiveCount
from maax_mjx.common.checks import check_positive
from maax_mjx.layout import Layout, poisson_disc, separation_placement

POINT = "point"


@dataclass
class Config(Options):
    """Options; `out` gets a picture of the same name beside it.

    Attributes:
        edges: floors in metres, on which points are wanted at the first of the densities.
        densities: points wanted per square of one radius; Bridson's algorithm fills a large floor with about 0.6. All
            of them are tried on the `full_edge` floor.
        full_edge: that floor's edge in metres.
        radius: least distance between two points in metres.
        tries: per point of `darts`, and the candidates of `poisson`; the thesis's k.
        cell: edge of the placement grid's cells in metres, as in the standard environment; a floor has a whole number.
        worlds: batch sizes of `field`.
        rounds: timed runs, each with a seed of its own, of which the median is reported.
    """

    edges: tuple[float, ...] = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
    densities: tuple[float, ...] = (0.3, 0.1, 0.2, 0.4, 0.5, 0.6, 0.7)
    full_edge: float = 6.0
    radius: float = 0.5
    tries: PositiveCount = 30
    cell: float = 0.2
    worlds: tuple[PositiveCount, ...] = (1, 256)
    rounds: PositiveCount = 7

    def check(self) -> None:
        super().check()
        for name in ("radius", "cell", "full_edge"):
            check_positive(name, getattr(self, name))
        for name in ("edges", "densities"):
            for value in getattr(self, name):
                check_positive(name, value)


@dataclass(frozen=True)
class Case:
    """One way on one floor.

    Attributes:
        sweep: what grows: "edge" or "density".
        method: poisson, darts or field.
        worlds: how many are drawn at once; 1 on the host.
        edge_m: of the floor.
        radius_m: least distance asked for.
        wanted: points per world.
    """

    sweep: str
    method: str
    worlds: int
    edge_m: float
    radius_m: float
    wanted: int


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case.

    Attributes:
        found: points per world, the mean over worlds and rounds.
        failures: points that found no place, over all worlds and rounds.
        closest_m: the least distance seen between two points, over all worlds and rounds; None with fewer than two.
        ms_per_world: median over rounds of the time to draw all worlds, over their number.
        first_s: the first call, which compiles on the device.
    """

    found: float
    failures: int
    closest_m: float | None
    ms_per_world: float
    first_s: float


Sampler = Callable[[int], list[np.ndarray] | jax.Array]
"""Points of every world by a round's number: a list of (k, 2), or (worlds, n, 3) x, y and whether it was placed."""


def throw_darts(n: int, radius: float, edge: float, seed: int, tries: int) -> np.ndarray:
    """Naive rejection: every point is thrown anywhere until it lands clear of all others, `tries` times at most.

    Returns:
        (k, 2) metres, k <= n: a point that never landed clear is left out.
    """
    rng = np.random.default_rng(seed)
    points = np.empty((n, 2))
    landed = 0
    for _ in range(n):
        for _ in range(tries):
            dart = rng.uniform(0, edge, 2)
            if (((points[:landed] - dart) ** 2).sum(axis=1) >= radius**2).all():
                points[landed] = dart
                landed += 1
                break
    return points[:landed]


class Scatter(Layout):
    """A layout whose objects are rows of one table, so that placing many is a loop and not a long program.

    Attributes:
        table: (n, 3) x, y and whether it was placed.
    """

    table: jax.Array

    def stacked_objects(self) -> jax.Array:
        return self.table


def scatter(n: int, radius: float, edge: float, cell: float, key: jax.Array) -> jax.Array:
    """Draws `n` points at least `radius` apart: (n, 3) x, y in metres, and whether each found a place. Traceable."""
    apart = separation_placement(radius)
    empty = Scatter.empty(round(edge / cell), edge, table=jnp.zeros((n, 3)))
    seeds = empty.seeds(key, n)

    def add(layout: Scatter, i: jax.Array) -> tuple[Scatter, None]:
        # A point takes its cell and lies anywhere in it.
        placed = layout.place(POINT, seeds[i], jnp.full(2, 1e-3), apart)[0]
        return layout.replace(grid=placed.grid, table=layout.table.at[i].set(placed.objects[POINT])), None

    return jax.lax.scan(add, empty, jnp.arange(n))[0].table


def closest(points: np.ndarray) -> float:
    """The least distance between any two of (n, 2) points; infinite for fewer than two."""
    squares = ((points[:, None] - points) ** 2).sum(axis=-1)
    np.fill_diagonal(squares, np.inf)
    return float(np.sqrt(squares.min(initial=np.inf)))


def cases(config: Config) -> Iterator[Case]:
    """Ways on every floor at the first density, and on one floor at all of them."""
    floors = [("edge", edge, config.densities[0]) for edge in config.edges]
    floors += [("density", config.full_edge, density) for density in sorted(config.densities)]
    ways = [("poisson", 1), ("darts", 1), *(("field", n_worlds) for n_worlds in config.worlds)]
    for (sweep, edge, density), (method, n_worlds) in product(floors, ways):
        yield Case(sweep, method, n_worlds, edge, config.radius, round(density * (edge / config.radius) ** 2))


def sampler(case: Case, config: Config) -> Sampler:
    """A case's way to draw the points of a round."""
    n, edge, radius, tries = case.wanted, case.edge_m, case.radius_m, config.tries
    if case.method == "poisson":
        return lambda i: [poisson_disc(n, radius, edge, i, candidates=tries)]
    if case.method == "darts":
        return lambda i: [throw_darts(n, radius, edge, i, tries)]
    # All worlds of a batch, in one compiled program.
    draw = jax.jit(jax.vmap(lambda key: scatter(n, radius, edge, config.cell, key)))
    keys = jax.random.split(jax.random.key(0), (config.rounds + 1, case.worlds))
    return lambda i: draw(keys[i])


def measure(case: Case, config: Config) -> Row:
    """Times all rounds after a first one, which compiles, and looks at the points."""
    draw = sampler(case, config)
    begun = time.perf_counter()
    jax.block_until_ready(draw(config.rounds))
    first_s = time.perf_counter() - begun
    spent, found, nearest = [], [], np.inf
    for i in range(config.rounds):
        begun = time.perf_counter()
        drawn = jax.block_until_ready(draw(i))
        spent.append(time.perf_counter() - begun)
        points = drawn if isinstance(drawn, list) else [world[world[:, 2] > 0, :2] for world in np.asarray(drawn)]
        found += [len(p) for p in points]
        nearest = min([nearest, *map(closest, points)])
    return Row(
        **vars(case),
        found=round(float(np.mean(found)), 2),
        failures=case.wanted * len(found) - sum(found),
        closest_m=round(nearest, 4) if np.isfinite(nearest) else None,
        ms_per_world=round(float(np.median(spent)) / case.worlds * 1e3, 4),
        first_s=round(first_s, 2),
    )


HEADER = "sweep    method   worlds  edge m  wanted    found  closest m  ms per world"


def line(row: Row) -> str:
    """A row of the table."""
    return (
        f"{row.sweep:8} {row.method:8} {row.worlds:6} {row.edge_m:7.1f} {row.wanted:7} {row.found:8.1f} "
        f"{row.closest_m or np.nan:10.4f} {row.ms_per_world:13.4f}"
    )


COMMAND = plots.with_picture(benchmark(Config, Row, cases, measure, line, HEADER), plots_worlds.sampling)

if __name__ == "__main__":
    COMMAND.cli()
