"""Curves through points with slopes are exact for cubics, and so are their crossings."""

import numpy as np
import pytest

from identknee.identify.profile.result import crossings, cubic


def height(x: float) -> float:
    return 2.0 * x**3 - 3.0 * x**2 - x + 4.0


def slope(x: float) -> float:
    return 6.0 * x**2 - 6.0 * x - 1.0


@pytest.mark.parametrize(("low", "high"), [(-1.0, 2.0), (0.5, 0.75), (-3.0, -1.0)])
def test_a_cubic_is_its_own_curve(low: float, high: float) -> None:
    ends = [(x, height(x), slope(x)) for x in (low, high)]
    for x in np.linspace(low, high, 11):
        assert cubic(float(x), ends[0], ends[1]) == pytest.approx(height(x), abs=1e-12)


def test_a_level_is_crossed_where_the_cubic_has_it() -> None:
    """x (x - 1) (x + 2) is zero at -2, 0 and 1; between points of one side nothing is sought."""
    places = np.array([-2.5, -1.0, 0.6, 2.0])
    values = places * (places - 1.0) * (places + 2.0)
    slopes = 3.0 * places**2 + 2.0 * places - 2.0
    np.testing.assert_allclose(crossings(places, values, slopes, 0.0), [-2.0, 0.0, 1.0], atol=1e-9)
    assert crossings(places, values, slopes, 100.0) == []
