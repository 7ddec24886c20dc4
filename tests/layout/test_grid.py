"""The placement grid and the search for a place, against brute force."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from helpers import seeds
from helpers.chance import P_MIN
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from maax_mjx.layout import Grid, Layout

CELL, FLOOR = 0.2, 6.0
TOL = 1e-4
equal, close = np.testing.assert_array_equal, np.testing.assert_allclose

G = 9


@jax.jit
def grid_answers(rects, cells):
    grid = Grid.create(G, G * CELL)
    for x, y, w, h, on in rects:
        grid = grid.mark(jnp.array([x, y]), jnp.array([w, h]), on == 1)
    return grid.occupancy(), grid.marks(cells), grid.free(cells)


corners, sizes = st.integers(0, G - 1), st.integers(0, G)
rectangles = st.lists(st.tuples(corners, corners, sizes, sizes, st.integers(0, 1)), min_size=4, max_size=4)
footprints = st.tuples(st.integers(1, G + 2), st.integers(1, G + 2))


@settings(max_examples=100)
@given(rects=rectangles, cells=footprints)
def test_free_cells_by_brute_force(rects, cells):
    taken = np.zeros((G, G), int)
    for x, y, w, h, on in rects:
        taken[x : x + w, y : y + h] += on
    occupancy, marks, free = map(np.asarray, grid_answers(np.array(rects, np.int32), np.array(cells, np.int32)))
    equal(occupancy, taken)
    for i, j in np.ndindex(G, G):
        held = taken[i : i + cells[0], j : j + cells[1]]
        assert marks[i, j] == held.sum()
        assert free[i, j] == (held.shape == cells and not held.any())


def place(seed, grid, extent, field, wanted=True):
    layout = Layout.empty(1, 1.0).replace(grid=grid)
    layout, centre, placed = layout.place("it", seed, extent, lambda *_: field, wanted)
    return layout.valid, placed, centre, layout.grid.occupancy() > 0


@jax.jit
def place_in_hole(seed, hole, extent, wanted):
    """One object into a grid that is free in the rectangle `hole` (x, y, w, h) alone."""
    x, y, w, h = hole
    grid = Grid.create(G, G * CELL)
    for corner, cells in (((0, 0), (x, G)), ((x + w, 0), (G, G)), ((x, 0), (w, y)), ((x, y + h), (w, G))):
        grid = grid.mark(jnp.array(corner), jnp.array(cells))
    return *place(seed, grid, extent, jnp.ones((G, G)), wanted), grid.occupancy() > 0


@settings(max_examples=100)
@given(data=st.data(), w=st.integers(1, G), h=st.integers(1, G), slack=st.sampled_from([0, 0.25, 0.95]))
def test_the_only_place_is_found(data, w, h, slack):
    hole = np.array([data.draw(st.integers(0, G - w)), data.draw(st.integers(0, G - h)), w, h], np.int32)
    seed = np.array(data.draw(st.tuples(*[st.integers(0, 2**32 - 1)] * 3)), np.uint32)
    extent = ((hole[2:] - slack) * CELL).astype(np.float32)
    valid, placed, centre, after, before = place_in_hole(seed, hole, extent, True)
    assert valid
    assert placed
    assert (~np.asarray(before)).sum() == w * h
    assert np.asarray(after).all()
    assert (centre - extent / 2 > hole[:2] * CELL - TOL).all()
    assert (centre + extent / 2 < (hole[:2] + hole[2:]) * CELL + TOL).all()
    # One more cell on either side is too much; and what the world does not want takes no place.
    for more, wanted in (((0, 0), False), ((CELL, 0), False), ((CELL, 0), True), ((0, CELL), True)):
        valid, placed, _, after, before = place_in_hole(seed, hole, extent + np.array(more, np.float32), wanted)
        assert bool(valid) is not wanted
        assert not placed
        equal(after, before)


def test_weights_are_respected():
    field = jnp.zeros((G, G)).at[2, 3].set(1.0).at[7, 1].set(3.0)
    grid, extent = Grid.create(G, G * CELL), jnp.array([CELL, CELL])
    draws = jax.vmap(lambda k: jax.random.bits(k, (3,), jnp.uint32))(jax.random.split(seeds.key(0), 4000))
    search = jax.jit(jax.vmap(lambda seed, field: place(seed, grid, extent, field), in_axes=(0, None)))
    valid, placed, _, taken = map(np.asarray, search(draws, field))
    assert (valid & placed).all()
    assert taken.sum() == taken[:, 2, 3].sum() + taken[:, 7, 1].sum() == 4000
    assert stats.chisquare([taken[:, 2, 3].sum(), taken[:, 7, 1].sum()], [1000, 3000]).pvalue > P_MIN
    assert not search(draws, 0 * field)[1].any()
