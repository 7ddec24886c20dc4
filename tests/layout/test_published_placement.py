"""The published placements and tries against tables and rejection sampling in NumPy; what may start in a doorway."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from scipy import stats

import maax_mjx as maax
from maax_mjx.benchmarks import published_oracle as oracle
from maax_mjx.benchmarks.published import doorways
from maax_mjx.benchmarks.published_oracle import CELL, G
from maax_mjx.core.generation import draw_layout
from maax_mjx.layout import Layout

FLOOR, N = 6.0, 2_000
PLACEMENTS = {
    "published_uniform": lambda cells, size: oracle.uniform(cells),
    "published_quad": oracle.quad,
    "published_outside_quad": oracle.outside_quad,
}


def floor_with_quadrant(size):
    """An empty floor with a quadrant of so many cells, wall included."""
    layout = Layout.empty(G, FLOOR)
    return layout.replace(plan=layout.plan.replace(quadrant=jnp.array([G - size + 1, 1, G - 1, size])))


def drawn(env, n, of):
    """What `of` takes of the layouts of so many worlds."""
    draw = jax.jit(jax.vmap(lambda key: of(draw_layout(env, key, env.default_params))))
    return jax.device_get(draw(jax.random.split(seeds.key(0), n)))


@pytest.mark.parametrize("size", [9, 15, 17])
@pytest.mark.parametrize("name", PLACEMENTS)
def test_places_are_as_likely_as_in_the_published_code(name, size):
    """Every cell's, for things of all sizes, in quadrants of any size."""
    placement = jax.jit(partial(getattr(maax, f"{name}_placement"), floor_with_quadrant(size)))
    for cells in np.array([[1, 1], [2, 2], [3, 3], [1, 6], [6, 1]]):
        weights = np.asarray(placement(jnp.asarray(cells)), float)
        np.testing.assert_allclose(weights / weights.sum(), oracle.chances(PLACEMENTS[name](cells, size)), atol=1e-7)


def test_without_a_quadrant_they_are_anywhere():
    for name in ("published_quad", "published_outside_quad"):
        weights = np.asarray(getattr(maax, f"{name}_placement")(Layout.empty(G, FLOOR), jnp.array([2, 2])))
        assert (weights == weights[0, 0]).all()
        assert weights[0, 0] > 0


def test_team_mates_are_around_the_first_of_them():
    """By name: the first of a team anywhere in its range of cells, the others near it."""
    for side in ("hider", "seeker"):
        env = maax.make("standard", impl="c", **{f"{side}_placement": "published_team", f"n_{side}s": 3})
        names = [fn.__name__ for fn in env.agents.placement_fns]
        first = names.index("published_uniform_placement")
        assert names[first + 1 : first + 3] == [f"published_proximity_placement(0.5, 'agent{first}')"] * 2


# --- tries -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tries", [1, 3, 10, None])
def test_as_often_as_one_of_the_tries_is_free_there_is_a_place(tries):
    """On a floor that is taken but for a share; the place is any of the free ones, as likely as it weighs."""
    layout = Layout.empty(G, FLOOR, tries=tries)
    layout = layout.replace(grid=layout.grid.mark(jnp.array([0, 0]), jnp.array([27, G])))
    weights = jnp.arange(1.0, G + 1)[:, None] * jnp.ones(G)

    @jax.jit
    @jax.vmap
    def placed(seed):
        after, centre, there = layout.place("thing", seed, jnp.array([0.1, 0.1]), lambda *_: weights)
        return centre, there, after.valid, after.grid.occupancy().sum()

    centre, there, valid, marks = jax.device_get(placed(layout.seeds(seeds.key(0), 4 * N)))
    weighs = np.arange(28, G + 1) / (G * (G + 1) / 2)
    share = 1.0 if tries is None else 1 - (1 - weighs.sum()) ** tries
    assert stats.binomtest(int(there.sum()), len(there), share).pvalue > P_MIN
    np.testing.assert_array_equal(valid, there)
    np.testing.assert_array_equal(marks, G * 27 + there)
    x, y = np.floor(centre[there] / CELL).astype(int).T
    assert x.min() == 27
    assert stats.chisquare(np.bincount(x - 27, minlength=3), weighs / weighs.sum() * len(x)).pvalue > P_MIN
    assert stats.chisquare(np.bincount(y, minlength=G)).pvalue > P_MIN


def crowded(rng, tries):
    """How many cubes, of 1 to 9 and an agent, a small floor has, in worlds that are drawn anew with their counts."""
    while True:
        n, blocked = rng.integers(1, 10), np.zeros((15, 15), bool)
        for cells in [2] + [3] * n:
            for _ in range(tries):
                x, y = rng.integers(1, 15 - cells - 1, 2)
                own = blocked[x : x + cells, y : y + cells]
                if not own.any():
                    own[:] = True
                    break
            else:
                break
        else:
            return n


@pytest.mark.slow
def test_what_does_not_fit_is_drawn_anew_with_its_counts():
    """Fewer of many are left, as many as in NumPy; without tries, counts stay as they were drawn."""
    counts = {}
    for tries in (3, None):
        env = maax.Base(1, impl="c", grid_size=15, floor_size=3.0, placement_tries=tries)
        env.add_module(maax.WallScenarios("empty", outer="none"))
        env.add_module(maax.Agents(1, maax.published_uniform_placement))
        env.add_module(maax.Boxes((1, 9), maax.published_uniform_placement))
        active, valid = drawn(env, N, lambda layout: (layout.active["box"], layout.valid))
        assert valid.mean() > 0.99
        counts[tries] = np.bincount(active.sum(axis=1)[valid], minlength=10)[1:]
    assert stats.chisquare(counts[None]).pvalue > P_MIN
    rng = seeds.rng(0)
    theirs = np.bincount([crowded(rng, 3) for _ in range(2 * N)], minlength=10)[1:]
    table = np.array([np.append(own[:6], own[6:].sum()) for own in (counts[3], theirs)])
    assert stats.chi2_contingency(table).pvalue > P_MIN
    assert counts[3][:3].sum() > 1.5 * counts[None][:3].sum()


@pytest.mark.parametrize("make", [lambda **own: maax.Base(1, **own), lambda **own: maax.make("standard", **own)])
@pytest.mark.parametrize("tries", [0, 1.5, -1, True, "10"])
def test_tries_that_are_none(make, tries):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        make(placement_tries=tries)
    assert str(error.value) == f"placement_tries: got {tries!r}; takes a whole number of at least 1, or None"


# --- doorways --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_only_cells_of_doorways_are_free_as_well():
    """The same worlds from the same keys, but for these cells."""
    taken, doors = [], None
    for in_doorways in (False, True):
        env = maax.Base(1, impl="c")
        env.add_module(maax.WallScenarios(["quad", "random", "tri"], n_rooms=4, in_doorways=in_doorways))
        env.add_module(maax.Agents(1))

        def without_agent(layout):
            corner, cells = jnp.floor(layout.objects["agent0"][:2] / CELL - 0.75 + 1e-3).astype(int), jnp.full(2, 2)
            return layout.grid.occupancy() - Layout.empty(G, FLOOR).grid.mark(corner, cells).occupancy(), layout.plan

        grids, plan = drawn(env, 200, without_agent)
        assert (grids >= 0).all()
        taken.append(grids > 0)
        doors = plan.doors if doors is None else doors
        np.testing.assert_array_equal(plan.doors, doors)
    freed = taken[0] & ~taken[1]
    assert not (taken[1] & ~taken[0]).any()
    for world, openings, mask in zip(freed, doors, plan.door_mask, strict=True):
        want = np.zeros_like(world)
        for x, y in openings[mask][:, :2] / CELL:
            vertical = abs(x % 1 - 0.5) < 1e-3
            first = [int(x), round(y) - 1] if vertical else [round(x) - 1, int(y)]
            want[first[0] : first[0] + 1 + (not vertical), first[1] : first[1] + 1 + vertical] = True
        np.testing.assert_array_equal(world, want)


@pytest.mark.slow
def test_what_may_start_in_doorways_starts_there():
    """Agents that ask for the line of the quadrant's walls find places in its doors alone, or none."""

    def on_the_line(layout, cells):
        x = jnp.arange(G)[:, None]
        return (x == G // 2) & (jnp.arange(G) < G // 2 - 1)

    for in_doorways in (False, True):
        env = maax.Base(1, impl="c")
        env.add_module(maax.WallScenarios("quad", in_doorways=in_doorways))
        env.add_module(maax.Agents(1, on_the_line))
        valid, doors, agent = drawn(
            env, 100, lambda layout: (layout.valid, layout.plan.doors, layout.objects["agent0"])
        )
        np.testing.assert_array_equal(valid, in_doorways)
    assert np.abs(doors[:, 0, 1] - agent[:, 1]).max() < 0.2


@pytest.mark.parametrize("mistake", [1, None, "yes"])
def test_neither_in_nor_out(mistake):
    for call in (maax.WallScenarios, lambda **own: maax.make("standard", **own)):
        with pytest.raises(ValueError, match=f"in_doorways: got {mistake!r}; takes True or False"):
            call(in_doorways=mistake)


def test_doors_of_the_quadrant_are_as_wide_as_published():
    """0.7 m; 0.1 m less beside a corner, where a piece of one cell does not stand."""
    env = maax.make("hide_and_seek_quadrant", impl="c", published=True).base
    plan = drawn(env, 500, lambda layout: layout.plan)
    doors, begins = plan.doors[plan.door_mask], doorways(plan)[plan.door_mask]
    is_upright = begins[:, 0] == begins[:, 2]
    first = np.where(is_upright, begins[:, 1], begins[:, 0])
    at_an_end = np.where(is_upright, np.isin(first, [1, 13]), np.isin(first, [16, 27]))
    np.testing.assert_allclose(doors[:, 2], np.where(at_an_end, 0.6, 0.7), atol=1e-5)
    assert 0.08 < at_an_end.mean() < 0.26
