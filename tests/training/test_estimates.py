"""Means and their margins as tables show them."""

import pytest

from maax_mjx.training import Estimate


@pytest.mark.parametrize(
    ("estimate", "shown"),
    [
        ((29.1, 110.4), "29.1 ± 110"), ((12345.6, 1234.5), "12346 ± 1234"), ((-116.64, 9.97), "-117 ± 10"),
        ((99.96, 99.6), "100 ± 100"), ((0.8512, 0.0213), "0.851 ± 0.021"), ((0.5, 0.00001), "0.5 ± 0.00001"),
        ((0.0, 0.0), "0 ± 0"), ((2.0, float("nan")), "2 ± nan"), ((1e20, 1e-9), "1e+20 ± 1e-09"),
    ],
)  # fmt: skip
def test_numbers_of_ordinary_sizes_have_no_exponent(estimate, shown):
    assert str(Estimate(*estimate)) == shown
