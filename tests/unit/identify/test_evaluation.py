"""Simulations are counted once each, and where there is no prediction that is data."""

import numpy as np
import pytest
from problems import Cliff, ClosedForm, sloppy_springs

from identknee.calibrate.objective import Ended
from identknee.identify.evaluation import Evaluator, evaluate
from identknee.runs.arrays import Array


@pytest.fixture
def problem() -> ClosedForm:
    return sloppy_springs(noise=0.1)


def test_residuals_and_jacobian_are_one_simulation(problem: ClosedForm) -> None:
    evaluator = Evaluator(problem)
    first = evaluator(problem.start)
    again = evaluator(np.array(problem.start))
    assert again is first
    assert evaluator.n_simulations == 1
    evaluator(problem.minimum)
    assert evaluator.n_simulations == 2


def test_deviance_is_twice_the_objective_and_its_gradient_is_exact(problem: ClosedForm) -> None:
    found = evaluate(problem, problem.start)
    assert found.deviance == pytest.approx(float(np.sum(problem.residuals(problem.start) ** 2)))
    step = 1e-6

    def deviance(theta: Array) -> float:
        return evaluate(problem, theta).deviance

    differences = [
        (deviance(problem.start + e) - deviance(problem.start - e)) / (2 * step)
        for e in step * np.eye(problem.parameters.n)
    ]
    # Central differences: rounding of the deviance over twice the step.
    bound = 1e-5 * max(1.0, np.abs(found.gradient).max())
    np.testing.assert_allclose(found.gradient, differences, atol=bound)


def test_no_prediction_has_infinite_deviance_and_asks_for_no_derivatives(
    problem: ClosedForm,
) -> None:
    found = evaluate(Cliff(problem=problem, beyond=lambda theta: 1.0), problem.start)
    assert not found.is_finite
    assert found.deviance == np.inf


def test_budget_ends_the_work(problem: ClosedForm) -> None:
    evaluator = Evaluator(problem, budget=1)
    evaluator(problem.start)
    with pytest.raises(Ended):
        evaluator(problem.minimum)
