"""Poisson-disc points against brute-force distances."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import seeds
from hypothesis import given
from hypothesis import strategies as st

import maax_mjx as maax

SEEDS = st.integers(0, 2**31 - 1)
FLOORS = st.floats(0.5, 50)


def closest(points):
    """The least distance between any two."""
    distances = np.linalg.norm(points[:, None] - points, axis=-1)
    return (distances + np.where(np.eye(len(points)), np.inf, 0)).min(initial=np.inf)


@given(st.none() | st.integers(0, 60), SEEDS, FLOORS, st.floats(0.08, 2), st.floats(0, 0.49))
def test_points_keep_apart_and_inside(n, seed, floor_size, radius_share, margin_share):
    radius, margin = radius_share * floor_size, margin_share * floor_size
    points = maax.poisson_disc(n, radius, floor_size, seed, margin)
    assert points.shape == (len(points), 2)
    assert n is None or len(points) <= n
    assert closest(points) >= radius
    assert (points >= margin).all()
    assert (points <= floor_size - margin).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_filled_floor_is_full_and_n_takes_from_it(seed):
    everything = maax.poisson_disc(None, 0.5, 4.0, seeds.seed(seed))
    axis = np.linspace(0, 4, 81)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    distance = np.linalg.norm(grid[:, None] - everything, axis=-1).min(axis=1)
    # k = 30 leaves few gaps: of 200 seeds, the emptiest floor had 2.9 % of it further than a radius from any point.
    assert (distance > 0.5).mean() < 0.05
    np.testing.assert_array_equal(maax.poisson_disc(7, 0.5, 4.0, seeds.seed(seed)), everything[:7])
    np.testing.assert_array_equal(maax.poisson_disc(10_000, 0.5, 4.0, seeds.seed(seed)), everything)


def test_few_points_are_spread_over_the_floor():
    points = np.concatenate([maax.poisson_disc(8, 0.5, 6.0, seeds.seed(seed)) for seed in range(25)])
    quarter = (points > 3.0) @ [1, 2]
    # 50 of 200 in each on average; all 200 in a quarter or two if growth had been cut short.
    assert (np.bincount(quarter, minlength=4) > 25).all()


def test_seeds():
    first, again, other = (maax.poisson_disc(20, 0.5, 6.0, seeds.seed(n)) for n in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_more_candidates_fill_more():
    few, many = (
        np.mean([len(maax.poisson_disc(None, 0.5, 5.0, seeds.seed(s), candidates=k)) for s in range(5)])
        for k in (2, 30)
    )
    assert few < many


GOOD = dict(n=5, radius=0.5, floor_size=6.0, seed=0)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (dict(n=-1), "n: got -1; takes a whole number of at least 0"),
        (dict(n=1.5), "n: got 1.5"),
        (dict(n=True), "n: got True"),
        (dict(radius=0), "radius: got 0; takes a positive number"),
        (dict(radius=float("nan")), "radius: got nan"),
        (dict(radius=1e-4), "radius: got 0.0001; takes at least 0.006 on this floor"),
        (dict(floor_size=-6), "floor_size: got -6"),
        (dict(floor_size=float("inf")), "floor_size: got inf"),
        (dict(margin=-0.1), "margin: got -0.1"),
        (dict(margin=3.0), "margin: got 3.0; takes a number of at least 0, below 3"),
        (dict(margin=(0.1, 0.2)), "margin: got"),
        (dict(margin=float("nan")), "margin: got nan"),
        (dict(seed=-1), "seed: got -1"),
        (dict(seed=None), "seed: got None"),
        (dict(candidates=0), "candidates: got 0; takes a whole number of at least 1"),
    ],
)
def test_errors(bad, message):
    with pytest.raises(ValueError, match=message):
        maax.poisson_disc(**GOOD | bad)
