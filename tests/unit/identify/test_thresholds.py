"""Thresholds against the laws they come from."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.stats
from problems import Linear, plain_parameters

from identknee.calibrate.problem import ParameterQuantity, Problem
from identknee.identify.profile.result import (
    BootstrapStatistics,
    bootstrap_statistics,
    chi2_threshold,
    f_threshold,
    threshold_below,
)

MATRIX = np.random.default_rng(3).normal(size=(7, 2))
TRUTH = np.array([1.0, -0.5])
N_DATA_SETS = 400


def _new_data(problem: Linear, seed: np.random.SeedSequence) -> Problem:
    noise = np.random.default_rng(seed).normal(size=len(problem.matrix))
    return replace(problem, data=problem.matrix @ TRUTH + noise)


def test_one_quantity_and_two() -> None:
    assert chi2_threshold(0.95) == pytest.approx(1.959963984540054**2)
    assert chi2_threshold(0.95, 2) == pytest.approx(-2.0 * np.log(0.05))


def test_unknown_noise_is_student_squared() -> None:
    assert f_threshold(0.95, 7) == pytest.approx(scipy.stats.t.ppf(0.975, 7) ** 2)
    assert f_threshold(0.95, 10**8) == pytest.approx(chi2_threshold(0.95), rel=1e-6)


@pytest.mark.slow
def test_simulated_data_of_a_linear_model_have_the_chi_squared_law() -> None:
    problem = Linear(parameters=plain_parameters(2), matrix=MATRIX, data=np.zeros(7))
    names = problem.parameters.names
    quantities = [ParameterQuantity(parameters=problem.parameters, name=x) for x in names]
    found = bootstrap_statistics(
        partial(_new_data, problem), TRUTH, quantities, n=N_DATA_SETS, seed=5
    )
    assert found.names == names
    assert found.n_failed == 0
    for column in found.statistics.T:
        # One column in a thousand fails by chance; the seed is fixed.
        assert scipy.stats.kstest(column, "chi2", args=(1,)).pvalue > 1e-3
    for threshold, low, high in found.thresholds(0.9):
        assert low < threshold < high
        assert low < chi2_threshold(0.9) < high


def test_data_sets_without_a_fit_are_counted_and_left_out() -> None:
    rows = np.r_[np.full((5, 1), np.nan), np.arange(1.0, 101.0)[:, None]]
    found = BootstrapStatistics(names=("x",), statistics=rows)
    assert found.n_failed == 5
    assert found.thresholds(0.9)[0, 0] == 90.0


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_impossible_levels_are_refused(level: float) -> None:
    with pytest.raises(ValueError, match=r"level.* 0 and 1"):
        chi2_threshold(level)


def test_no_degrees_of_freedom_are_refused() -> None:
    with pytest.raises(ValueError, match=r"1 degree.*got 0"):
        f_threshold(0.95, 0)


def test_too_few_data_sets_are_refused() -> None:
    few = BootstrapStatistics(names=("x",), statistics=np.zeros((10, 1)))
    with pytest.raises(ValueError, match=r"10 data sets.*0\.95"):
        few.thresholds(0.95)


@pytest.mark.parametrize("degrees", [3, 10, 55])
def test_two_quantities_at_once_have_twice_the_quantile_of_f(degrees: int) -> None:
    """In closed form: of F with 2 and d degrees, P(F > x) = (1 + 2 x / d)^(-d / 2)."""
    quantile = 0.5 * degrees * (0.05 ** (-2.0 / degrees) - 1.0)
    assert f_threshold(0.95, degrees, 2) == pytest.approx(2.0 * quantile)
    assert f_threshold(0.95, 10**8, 3) == pytest.approx(chi2_threshold(0.95, 3), rel=1e-6)


def test_a_lower_level_keeps_the_proportion_of_the_law_of_as_many_quantities() -> None:
    """Of two numbers the chi-squared quantile at p is -2 ln(1 - p)."""
    proportion = np.log(1.0 - 0.68) / np.log(1.0 - 0.95)
    assert threshold_below(7.0, 0.95, 0.68, 2) == pytest.approx(7.0 * proportion)
