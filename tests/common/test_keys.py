"""Keys by name, and whether what is drawn from a key is uniform."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds
from helpers.chance import P_MIN
from scipy import stats

from maax_mjx.common.keys import draw_integer, draw_one, hashed, named_key, named_keys

equal = np.testing.assert_array_equal
NAMES = ["boxes", "box", "ramps", "agents", "n_boxes", "box_size", ""]
N = 20_000


def data(keys):
    return np.asarray(jax.random.key_data(keys))


def test_names_have_keys_of_their_own():
    """Every pair of a key and a name has another; the order of the names does not matter."""
    keys = [data(named_keys(seeds.key(n), NAMES)) for n in range(5)]
    assert len(np.unique(np.concatenate(keys), axis=0)) == 5 * len(NAMES)
    equal(data(named_keys(seeds.key(0), NAMES[::-1])), keys[0][::-1])
    for name, one in zip(NAMES, keys[0], strict=True):
        equal(data(named_key(seeds.key(0), name)), one)


def test_a_name_has_the_same_key_in_every_process():
    """Python's own hash of a text differs between processes; CRC-32 does not, whose check value is this."""
    equal(data(named_key(seeds.key(0), "123456789")), data(jax.random.fold_in(seeds.key(0), np.uint32(0xCBF43926))))


@pytest.mark.parametrize(("low", "high"), [(0, 1), (3, 9), (-4, 2), (5, 5), (0, 99)])
def test_whole_numbers_are_uniform_with_both_ends(low, high):
    drawn = jax.vmap(lambda key: draw_integer(key, low, high))(jax.random.split(seeds.key(1), N))
    assert drawn.dtype == jnp.int32
    assert low <= drawn.min() <= drawn.max() <= high
    if high > low:
        assert stats.chisquare(np.bincount(np.asarray(drawn) - low, minlength=high - low + 1)).pvalue > P_MIN


def test_ranges_may_differ_from_draw_to_draw():
    low = jnp.arange(N) % 7
    high = low + jnp.arange(N) % 3
    drawn = np.asarray(jax.vmap(draw_integer)(jax.random.split(seeds.key(2), N), low, high))
    assert (drawn >= low).all()
    assert (drawn <= high).all()
    assert stats.chisquare(np.bincount((drawn - low)[np.asarray(high - low) == 2])).pvalue > P_MIN


def reference(seed, index):
    """The hash in Python's whole numbers, which do not overflow."""
    x = (index * 0x9E3779B9 ^ seed) & 0xFFFFFFFF
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x = ((x ^ x >> shift) * factor) & 0xFFFFFFFF
    return x ^ x >> 16


def test_hash_is_that_of_whole_numbers():
    pairs = seeds.rng(3).integers(0, 2**32, (100, 2), dtype=np.uint32)
    got = np.asarray(hashed(jnp.asarray(pairs[:, 0]), jnp.asarray(pairs[:, 1])))
    equal(got, np.array([reference(int(s), int(i)) for s, i in pairs], np.uint32))


@pytest.mark.parametrize("along", ["seed", "index"])
def test_hashes_of_neighbours_are_uniform_and_independent(along):
    """Every bit is set half of the time, and of neighbours each bit differs half of the time."""
    numbers = jnp.arange(N, dtype=jnp.uint32) + seeds.seed(0)
    one = jnp.uint32(seeds.seed(12345))
    got = np.asarray(hashed(numbers, one) if along == "seed" else hashed(one, numbers))
    assert len(np.unique(got)) == N, "it is a permutation of 32 bits"
    bits = got[:, None] >> np.arange(32, dtype=np.uint32) & 1
    for share in (bits.mean(axis=0), (bits[1:] ^ bits[:-1]).mean(axis=0)):
        # Five standard deviations of the mean of N coins, half as wide again: a hash is no coin.
        assert np.abs(share - 0.5).max() < 7.5 * 0.5 / np.sqrt(N)
    assert stats.chisquare(np.bincount(got >> 24, minlength=256)).pvalue > P_MIN


def test_one_is_drawn_among_those_who_may():
    among = jnp.array([[True, False, True, False], [True, False, False, True], [True, False, True, True]])
    key = seeds.key(4)
    drawn = np.asarray(jax.jit(jax.vmap(lambda step: draw_one(key, step, among)))(jnp.arange(N)))
    assert drawn.shape == (N, 4)
    assert drawn.dtype == np.int32
    equal(drawn[:, 1], 0)
    for column, allowed in ((0, [0, 1, 2]), (2, [0, 2]), (3, [1, 2])):
        counts = np.bincount(drawn[:, column], minlength=3)
        equal(np.flatnonzero(counts), allowed)
        assert stats.chisquare(counts[allowed]).pvalue > P_MIN
    # Columns are drawn independently, and so are steps that follow each other.
    assert stats.chi2_contingency(np.histogram2d(drawn[:, 0], drawn[:, 3], (3, 2))[0]).pvalue > P_MIN
    assert stats.chi2_contingency(np.histogram2d(drawn[1:, 0], drawn[:-1, 0], (3, 3))[0]).pvalue > P_MIN


def test_worlds_draw_apart():
    """At one step, from the keys of many worlds."""
    among = jnp.ones((4,), bool)
    drawn = jax.vmap(lambda key: draw_one(key, jnp.int32(7), among))(jax.random.split(seeds.key(5), N))
    assert stats.chisquare(np.bincount(np.asarray(drawn), minlength=4)).pvalue > P_MIN
