"""Operations on arrays against NumPy's."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import seeds

from maax_mjx.common.arrays import null_rows, shown, with_rows

equal = np.testing.assert_array_equal


@pytest.mark.parametrize("rows", [[4], [0, 5, 2], [[3, 1], [0, 5]], [], range(6)], ids=str)
@pytest.mark.parametrize("shape", [(6,), (6, 3), (6, 2, 2)], ids=str)
@pytest.mark.parametrize("dtype", [np.float32, np.int32, bool])
def test_rows_are_set_as_numpy_sets_them(rows, shape, dtype):
    rng = seeds.rng(0)
    rows = np.array(rows, int)
    array = (10 * rng.normal(size=shape)).astype(dtype)
    values = (10 * rng.normal(size=(*rows.shape, *shape[1:]))).astype(np.float32)
    want = array.copy()
    want[rows] = values.astype(dtype)
    got = jax.jit(lambda array, values: with_rows(array, rows, values))(array, values)
    assert got.dtype == dtype
    equal(got, want)


@pytest.mark.parametrize("shape", [(4,), (4, 3), (4, 3, 2)], ids=str)
@pytest.mark.parametrize("n_axes", [1, 2])
def test_what_is_masked_is_zero(shape, n_axes):
    rng = seeds.rng(1)
    n_axes = min(n_axes, len(shape))
    array, mask = rng.normal(size=shape).astype(np.float32), rng.random(shape[:n_axes]) < 0.5
    want = array.copy()
    want[~mask] = 0
    equal(shown(jnp.asarray(array), jnp.asarray(mask)), want)


def test_what_is_masked_is_zero_even_where_it_is_not_a_number():
    equal(shown(jnp.array([jnp.nan, 1.0, jnp.inf]), jnp.array([False, True, False])), [0, 1, 0])


def test_dtypes_stay():
    for array in (jnp.ones(3, bool), jnp.ones((3, 2), jnp.int32)):
        assert shown(array, jnp.array([True, False, True])).dtype == array.dtype


def test_rows_of_agents_are_zero():
    rng = seeds.rng(2)
    arrays = {"a": rng.normal(size=(5, 3)).astype(np.float32), "b": np.ones((5, 2, 2), bool), "c": np.arange(1, 6)}
    who = np.array([True, False, False, True, False])
    got = null_rows({name: jnp.asarray(x) for name, x in arrays.items()}, jnp.asarray(who))
    assert list(got) == list(arrays)
    for name, array in arrays.items():
        equal(got[name][who], np.zeros_like(array[who]))
        equal(got[name][~who], array[~who])
