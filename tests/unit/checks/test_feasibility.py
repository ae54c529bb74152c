"""How much of what the data allow has no prediction, and that results say so."""

import numpy as np
import pytest
from problems import Cliff, linear
from scipy.stats import norm

from identknee.calibrate.problem import evaluate
from identknee.checks.fit_checks import feasibility_findings, infeasible_proportion
from identknee.identify.posterior.posterior import newton_kernel
from identknee.runs.findings import Severity


def _sd(index: int) -> float:
    """Posterior standard deviation of a parameter of the linear problem, by its formula."""
    problem = linear()
    parameters = problem.parameters
    jacobian = problem.jacobian(problem.minimum)
    precision = jacobian.T @ jacobian + np.diag(parameters.prior_sd**-2.0)
    return float(np.sqrt(np.linalg.inv(precision)[index, index]))


@pytest.mark.parametrize("distance", [0.0, 0.5, 1.0])
def test_a_straight_boundary_cuts_off_the_tail_of_a_normal_density(distance: float) -> None:
    problem = linear()
    edge = problem.minimum[0] + distance * _sd(0)
    cut = Cliff(problem=problem, beyond=lambda x: float(x[0]) - edge)
    kernel = newton_kernel(evaluate(problem, problem.minimum), problem.parameters)
    assert np.isfinite(kernel.log_density)
    n = 2000
    found = infeasible_proportion(cut, problem.minimum, n_draws=n, seed=3)
    expected = norm.sf(distance)
    assert found.value == pytest.approx(expected, abs=4.0 * np.sqrt(expected * (1 - expected) / n))


def test_a_result_cut_by_the_model_says_so() -> None:
    problem = linear()
    edge = problem.minimum[0] + 0.5 * _sd(0)
    cut = Cliff(problem=problem, beyond=lambda x: float(x[0]) - edge)
    (finding,) = feasibility_findings(cut, problem.minimum)
    assert (finding.code, finding.severity) == ("sets-without-prediction", Severity.WARNING)
    assert 0 < finding.values["n_lost"] < finding.values["n"]


def test_a_boundary_far_away_is_not_mentioned() -> None:
    problem = linear()
    far = Cliff(problem=problem, beyond=lambda x: float(x[0]) - problem.minimum[0] - 6.0 * _sd(0))
    assert feasibility_findings(far, problem.minimum) == ()


def test_without_a_prediction_at_the_fit_it_refuses() -> None:
    nowhere = Cliff(problem=linear(), beyond=lambda _: 1.0)
    with pytest.raises(ValueError, match="no prediction"):
        infeasible_proportion(nowhere, np.zeros(3))
