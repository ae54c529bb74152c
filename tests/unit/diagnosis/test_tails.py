"""Tails against scipy, simulation and known expansions."""

import numpy as np
import pytest
from scipy import stats

from identknee.diagnosis.misfit import (
    log_chi2_tail,
    log_tail_of_z_score,
    log_weighted_tail,
    z_score_of_log_tail,
)

N_DRAWS = 200_000


@pytest.mark.parametrize("degrees", [1.0, 2.7, 8.0, 24.0])
def test_chi_square_tail_is_that_of_scipy(degrees: float) -> None:
    values = np.array([-1.0, 0.0, 0.5, 3.0, 40.0, 300.0])
    expected = stats.chi2.logsf(np.maximum(values, 0.0), degrees)
    np.testing.assert_allclose(log_chi2_tail(values, degrees), expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("degrees", [1.0, 8.0, 24.0])
def test_chi_square_tail_goes_on_where_numbers_underflow(degrees: float) -> None:
    """Across the change of formula the slope is minus a half and changes by little."""
    values = np.linspace(1200.0, 1400.0, 401)
    steps = np.diff(log_chi2_tail(values, degrees)) / np.diff(values)
    np.testing.assert_allclose(steps, -0.5 + (degrees / 2 - 1) / values[1:], atol=1e-4)
    assert np.isfinite(log_chi2_tail(np.array([1e8]), degrees)).all()


def test_one_signed_or_unsigned_normal_is_exact() -> None:
    z_scores = np.array([0.3, 2.0, 5.0, 60.0])
    np.testing.assert_allclose(
        log_chi2_tail(z_scores**2, 1.0), np.log(2) + log_tail_of_z_score(z_scores), rtol=1e-6
    )
    np.testing.assert_allclose(
        z_score_of_log_tail(log_tail_of_z_score(z_scores)), z_scores, rtol=1e-9
    )


@pytest.mark.parametrize("weights", [[1.0, 0.1], [1.0, 0.9, 0.5, 0.02], [0.3] * 6])
def test_weighted_tail_is_that_of_simulation(weights: list[float]) -> None:
    draws = np.random.default_rng(0).standard_normal((N_DRAWS, len(weights))) ** 2 @ weights
    for probability in (0.1, 0.01, 0.001):
        value = np.array(np.quantile(draws, 1 - probability))
        tail = float(np.exp(log_weighted_tail(value, np.array(weights))))
        # The simulated quantile is good to one over the root of the draws beyond it.
        assert tail == pytest.approx(probability, rel=5 / np.sqrt(N_DRAWS * probability) + 0.05)
