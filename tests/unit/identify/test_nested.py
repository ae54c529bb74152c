"""Nested sampling as a second opinion: evidence known in closed form, marginals as sampled."""

import numpy as np
import pytest
from problems import Linear, disc_in_the_way, plain_parameters

from identknee.identify.posterior.posterior import StopRule
from identknee.identify.posterior.sample import nested_posterior, quantile_differences, sample

pytest.importorskip("dynesty")
# In joint Monte Carlo standard errors: six quantiles together stay within at 99.7 % each.
AGREEMENT = 3.0
SIGMAS = 5.0


def line() -> Linear:
    matrix = np.array([[2.0, 0.5], [0.0, 1.0], [1.0, -1.0]])
    parameters = plain_parameters(2, -50.0, 50.0)
    return Linear(parameters=parameters, matrix=matrix, data=np.array([1.0, -1.0, 0.5]))


@pytest.mark.slow
def test_evidence_and_marginals_of_a_linear_problem() -> None:
    problem = line()
    found = nested_posterior(problem, n_live=250, seed=1)
    matrix, data = problem.matrix, problem.data
    precision = matrix.T @ matrix + np.eye(2) / 4.0
    mean = np.linalg.solve(precision, matrix.T @ data)
    lowest = np.sum((matrix @ mean - data) ** 2) + np.sum(mean**2) / 4.0
    # Of the normal integral; the bounds cut off nothing that counts.
    expected = -0.5 * lowest - 0.5 * np.linalg.slogdet(4.0 * precision)[1]
    assert abs(found.log_evidence - expected) < SIGMAS * found.log_evidence_error
    sampled = sample(problem, rule=StopRule(drift=np.inf), seed=1)
    assert np.all(np.abs(quantile_differences(sampled, found)) < AGREEMENT)
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.effective_draws < len(found.samples)


def test_where_there_is_no_prediction_there_is_no_posterior() -> None:
    found = nested_posterior(disc_in_the_way(), n_live=100, seed=2)
    used = found.samples[found.weights > 1e-12]
    assert np.all(np.sum(used**2, axis=1) >= 4.0)


def test_too_few_live_points_are_refused() -> None:
    with pytest.raises(ValueError, match="4 live points"):
        nested_posterior(line(), n_live=3)
