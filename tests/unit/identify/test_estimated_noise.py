"""Noise estimated from what a fit leaves, against the formulas of linear regression."""

import numpy as np
import pytest
from problems import Linear, plain_parameters

from identknee.identify.optimum import with_estimated_noise
from identknee.runs.declare import IntArray


def linear(seed: int, sds: tuple[float, float], n: int) -> tuple[Linear, IntArray]:
    generator = np.random.default_rng(seed)
    groups = np.arange(n) % len(sds)
    matrix = generator.standard_normal((n, 8))
    data = matrix @ np.full(8, 5.0) + np.array(sds)[groups] * generator.standard_normal(n)
    return Linear(parameters=plain_parameters(8), matrix=matrix, data=data), groups


def test_one_group_is_the_residual_variance_of_linear_regression() -> None:
    problem, _ = linear(1, (0.3, 0.3), 40)
    found = with_estimated_noise(problem, np.zeros(40, int), np.full(8, 4.0))
    _, squares, _, _ = np.linalg.lstsq(problem.matrix, problem.data, rcond=None)
    assert found.degrees_of_freedom == 32
    assert found.sds[0] == pytest.approx(np.sqrt(squares[0] / 32), rel=1e-8)
    scaled = found.problem.residuals(found.theta)
    assert scaled @ scaled == pytest.approx(32, rel=1e-8)


def test_two_groups_find_their_own_noise() -> None:
    estimates = []
    for seed in range(30):
        problem, groups = linear(seed, (0.2, 1.0), 120)
        estimates.append(with_estimated_noise(problem, groups, np.full(8, 4.0)).sds)
    # The variance of an sd estimate is sd^2 / (2 degrees), here about 56 each; 4 standard errors.
    bound = 4 / np.sqrt(2 * 56 * 30)
    np.testing.assert_allclose(np.mean(estimates, axis=0) / [0.2, 1.0], 1.0, atol=bound)


def test_too_few_values_are_refused() -> None:
    problem, _ = linear(2, (0.3, 0.3), 8)
    with pytest.raises(ValueError, match="too few"):
        with_estimated_noise(problem, np.zeros(8, int), np.full(8, 4.0))


def test_exact_data_are_refused() -> None:
    problem, _ = linear(3, (0.0, 0.0), 40)
    with pytest.raises(ValueError, match="no noise"):
        with_estimated_noise(problem, np.zeros(40, int), np.full(8, 4.0))
