"""Shares have the exact limits of a binomial count."""

import math

import pytest
from scipy.stats import binom

from identknee.identify.binomial_interval import share

ROOT = 1e-9


@pytest.mark.parametrize(("count", "n"), [(3, 10), (57, 500), (499, 500)])
def test_limits_leave_a_fortieth_on_each_side(count: int, n: int) -> None:
    found = share(count, n)
    assert binom.sf(count - 1, n, found.lower) == pytest.approx(0.025, rel=1e-6)
    assert binom.cdf(count, n, found.upper) == pytest.approx(0.025, rel=1e-6)
    assert found.value == count / n


def test_none_and_all_are_closed_on_their_side() -> None:
    assert share(0, 20).lower == 0.0
    assert share(0, 20).upper == pytest.approx(1 - 0.025 ** (1 / 20), abs=ROOT)
    assert share(20, 20).upper == 1.0


def test_an_empty_sample_says_nothing() -> None:
    empty = share(0, 0)
    assert (empty.lower, empty.upper) == (0.0, 1.0)
    assert math.isnan(empty.value)
    assert str(empty) == "none of none"


def test_a_count_beyond_the_sample_is_refused() -> None:
    with pytest.raises(ValueError, match="5 of 5, got 6"):
        share(6, 5)
