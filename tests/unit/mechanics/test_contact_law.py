"""The pressure of contact: the paper's law, and how a rounded one joins it."""

import numpy as np
import pytest
from scipy.integrate import quad

from identknee.mechanics.contact_elements import effective_depth
from identknee.mechanics.distance_field import (
    MOST_ROUNDING,
    PRESSURE_MODULUS,
    REFERENCE_DEPTH,
    ContactLaw,
)

DEPTHS = np.array([-0.3, -0.15, -0.1, -1e-6, 0.0, 1e-6, 0.05, 0.15, 0.2, 0.6])


def test_the_papers_law_is_a_spring_in_compression() -> None:
    pressure, slope = ContactLaw().pressure(DEPTHS)
    np.testing.assert_allclose(pressure, PRESSURE_MODULUS * np.maximum(DEPTHS, 0.0), rtol=1e-12)
    np.testing.assert_allclose(slope, PRESSURE_MODULUS * (DEPTHS > 0.0), rtol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 1.4])
def test_rounding_begins_at_its_gap_and_ends_at_its_depth(exponent: float) -> None:
    rounded = ContactLaw(exponent=exponent, rounding=0.1).pressure(np.array([-0.1, 0.0, 0.1, 0.3]))
    exact = ContactLaw(exponent=exponent).pressure(np.array([0.0, 0.025, 0.1, 0.3]))
    # The parabola is a quarter of the rounding where the surfaces just touch.
    np.testing.assert_allclose(rounded[0], exact[0], rtol=1e-12)
    np.testing.assert_allclose(rounded[1][2:], exact[1][2:], rtol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 1.4])
@pytest.mark.parametrize("rounding", [0.0, 0.05, MOST_ROUNDING])
def test_slope_and_energy_are_those_of_the_pressure(exponent: float, rounding: float) -> None:
    law = ContactLaw(exponent=exponent, rounding=rounding)

    def pressure(depth: float) -> float:
        return float(law.pressure(np.array([depth]))[0][0])

    for depth in DEPTHS[np.abs(np.abs(DEPTHS) - rounding) > 1e-3]:
        felt, steepness, stored = effective_depth(depth, exponent, rounding)
        spring = PRESSURE_MODULUS * (felt / REFERENCE_DEPTH) ** (exponent - 1.0) if felt else 0.0
        assert spring * felt == pytest.approx(pressure(depth), rel=1e-12, abs=1e-15)
        slope = (pressure(depth + 1e-7) - pressure(depth - 1e-7)) / 2e-7
        assert law.pressure(np.array([depth]))[1][0] == pytest.approx(slope, rel=1e-5, abs=2e-5)
        assert spring * exponent * steepness == pytest.approx(slope, rel=1e-5, abs=2e-5)
        work = quad(pressure, -rounding, max(depth, -rounding), points=[rounding], limit=200)[0]
        assert spring * stored == pytest.approx(work, rel=1e-7, abs=1e-10)


@pytest.mark.parametrize("rounding", [-0.01, 0.2])
def test_a_rounding_that_the_field_does_not_hold_is_refused(rounding: float) -> None:
    with pytest.raises(ValueError, match=r"must be 0 to 0.15 mm, got"):
        ContactLaw(rounding=rounding)
