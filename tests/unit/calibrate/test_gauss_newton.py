import numpy as np
import pytest
from problems import ClosedForm, active_bounds, linear

from identknee.calibrate.least_squares import GaussNewton, gauss_newton
from identknee.calibrate.problem import Evaluation, evaluate
from identknee.runs.declare import Array


def at(problem: ClosedForm, theta: Array) -> GaussNewton:
    return gauss_newton(evaluate(problem, theta), problem.parameters)


def test_one_step_solves_a_linear_problem() -> None:
    problem = linear()
    step = at(problem, problem.start)
    np.testing.assert_allclose(problem.start + step.step, problem.minimum, rtol=1e-12)
    start = np.sum(problem.residuals(problem.start) ** 2)
    assert step.reduction == pytest.approx(start - 2.0 * problem.lowest, rel=1e-12)
    assert step.length == pytest.approx(np.max(np.abs(step.step)) / 2.0, rel=1e-14)
    assert not step.is_stationary
    assert at(problem, problem.minimum).is_stationary


def test_active_bounds_are_not_left() -> None:
    problem = active_bounds()
    end = at(problem, problem.minimum)
    assert end.is_stationary
    assert end.gradient_norm == 0.0
    inside = np.array([0.5, 1.25, 4.0])
    landed = inside + at(problem, inside).step
    assert landed[0] == pytest.approx(0.0, abs=1e-15)
    assert landed[2] == pytest.approx(5.0, rel=1e-15)


def test_a_gradient_that_leads_inward_counts_at_a_bound() -> None:
    problem = active_bounds()
    theta = np.array([0.0, 1.0, 0.0])
    end = at(problem, theta)
    assert not end.is_stationary
    # d/dx2 of (x2 - 9)^2 is -18, times the typical 2 %.
    assert end.gradient_norm == pytest.approx(36.0, rel=1e-14)


@pytest.mark.parametrize("null", [0.0, 1e-17])
def test_directions_that_change_nothing_are_not_taken(null: float) -> None:
    problem = linear()
    jacobian = np.array(problem.jacobian(problem.start))
    jacobian[:, 2] = jacobian[:, 0] * (1 + null) + null
    residuals = problem.residuals(problem.start)
    here = Evaluation(theta=problem.start, residuals=residuals, jacobian=jacobian)
    step = gauss_newton(here, problem.parameters)
    # Least squares of the two directions that count, shared equally between equal columns.
    expected = np.linalg.lstsq(jacobian, -residuals, rcond=1e-12)[0]
    np.testing.assert_allclose(step.step, expected, rtol=1e-6)


def test_no_derivative_at_all_is_stationary() -> None:
    problem = linear()
    flat = Evaluation(theta=problem.start, residuals=np.ones(8), jacobian=np.zeros((8, 3)))
    end = gauss_newton(flat, problem.parameters)
    assert end.is_stationary
    assert end.length == 0.0
    assert end.gradient_norm == 0.0
