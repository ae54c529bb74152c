"""Second derivatives learned between points: the secant equation, and valleys that need them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems import ClosedForm, plain_parameters

from identknee.calibrate import bounded_least_squares
from identknee.calibrate.bounded_least_squares import (
    BoundedStep,
    bounded_step,
    minimise,
    solve_constrained,
)
from identknee.calibrate.problem import LARGE, Curvature, Evaluator, ParameterQuantity, evaluate
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

T = np.arange(1, 21) / 5.0
NUISANCES = np.array([False, True, True, True])


def brown_and_dennis(*, has_nuisances: bool) -> ClosedForm:
    """Problem 16 of More, Garbow and Hillstrom (1981), doi:10.1145/355934.355936: large residuals.

    Its lowest sum of squares is 85822.2.
    """

    def parts(theta: Array) -> tuple[Array, Array]:
        first = theta[0] + theta[1] * T - np.exp(T)
        return first, theta[2] + theta[3] * np.sin(T) - np.cos(T)

    def residuals(theta: Array) -> Array:
        first, second = parts(theta)
        return np.asarray(first**2 + second**2)

    def jacobian(theta: Array) -> Array:
        first, second = parts(theta)
        columns = [first, first * T, second, second * np.sin(T)]
        return np.asarray(2.0 * np.stack(columns, axis=1))

    parameters: Parameters = plain_parameters(4, -100.0, 100.0)
    if has_nuisances:
        parameters = replace(parameters, is_nuisance=NUISANCES)
    return ClosedForm(
        name="Brown and Dennis",
        parameters=parameters,
        start=np.array([25.0, 5.0, -5.0, -1.0]),
        minimum=np.array([-11.594439, 13.203630, -0.403439, 0.236779]),
        lowest=42911.1,
        residuals_at=residuals,
        jacobian_at=jacobian,
    )


@pytest.mark.parametrize("large", [LARGE, 0])
def test_what_is_learned_explains_the_change_of_the_gradient(
    large: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("identknee.calibrate.problem.LARGE", large)
    problem = brown_and_dennis(has_nuisances=True)
    before = evaluate(problem, problem.start)
    after = evaluate(problem, problem.start + np.array([0.3, -0.1, 0.2, 0.4]))
    curvature = Curvature(4)
    assert not curvature.is_known
    curvature.learn(before, after)
    matrix, _ = curvature.model(after, np.ones(4))
    step = after.theta - before.theta
    # Gauss-Newton's part is subtracted: the rest is what the Jacobian's own change makes.
    learned = matrix.T @ matrix - after.information
    wanted = (after.jacobian - before.jacobian).T @ after.residuals
    np.testing.assert_allclose(learned @ step, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_nothing_is_learned_of_a_linear_problem() -> None:
    problem = brown_and_dennis(has_nuisances=True)
    before = evaluate(problem, problem.start)
    after = replace(
        before,
        theta=before.theta + 1.0,
        residuals=before.residuals + before.jacobian.sum(axis=1),
    )
    curvature = Curvature(4)
    curvature.learn(before, after)
    matrix, data = curvature.model(after, np.ones(4))
    np.testing.assert_allclose(matrix.T @ matrix, after.information, rtol=1e-9)
    np.testing.assert_allclose(matrix.T @ data, 0.5 * after.gradient, rtol=1e-9)


def test_a_model_that_curves_down_leads_downhill() -> None:
    """A saddle of the model: its step must still lower the deviance."""
    problem = brown_and_dennis(has_nuisances=True)
    here = evaluate(problem, problem.start)
    curvature = Curvature(4)
    curvature._matrix = -3.0 * here.information
    matrix, data = curvature.model(here, np.ones(4))
    step = -np.linalg.solve(matrix.T @ matrix, matrix.T @ data)
    assert step @ here.gradient < 0.0
    np.testing.assert_allclose(matrix.T @ matrix, 2.0 * here.information, rtol=1e-6)


def test_large_residuals_end_where_gauss_and_newton_alone_do_not() -> None:
    problem = brown_and_dennis(has_nuisances=True)
    found = minimise(Evaluator(problem), problem.start)
    assert found.outcome is Outcome.MINIMUM
    assert found.n_simulations < 60
    assert found.evaluation.deviance == pytest.approx(2.0 * problem.lowest, rel=1e-6)
    np.testing.assert_allclose(found.evaluation.theta, problem.minimum, atol=1e-3)
    exact = brown_and_dennis(has_nuisances=False)
    alone = minimise(Evaluator(exact), exact.start, most_steps=500)
    assert alone.outcome is Outcome.VALLEY


def test_only_a_step_that_may_be_the_last_is_compared_with_the_linear_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps: list[BoundedStep] = []

    def counted(*how: Any) -> BoundedStep:
        steps.append(bounded_step(*how))
        return steps[-1]

    monkeypatch.setattr(bounded_least_squares, "bounded_step", counted)
    problem = brown_and_dennis(has_nuisances=True)
    found = minimise(Evaluator(problem), problem.start)
    assert found.outcome is Outcome.MINIMUM
    # One step follows each simulation; the linear model's is one more where the search may end.
    assert found.n_simulations < len(steps) <= found.n_simulations + 2


def test_the_tangent_of_a_curved_path_is_its_slope() -> None:
    problem = brown_and_dennis(has_nuisances=True)
    first = ParameterQuantity(parameters=problem.parameters, name=problem.parameters.names[0])
    evaluator = Evaluator(problem)
    at = [
        solve_constrained(evaluator, problem.minimum, quantity=first, target=value, tolerance=1e-10)
        for value in (-9.02, -8.98, -9.0)
    ]
    slope = (at[1].evaluation.theta - at[0].evaluation.theta) / 0.04
    np.testing.assert_allclose(at[2].tangent, slope, atol=0.02)
    by_jacobian = at[2].evaluation.jacobian[:, 1:]
    linear = -np.linalg.lstsq(by_jacobian, at[2].evaluation.jacobian[:, 0], rcond=None)[0]
    # Gauss and Newton alone have another path: the test would not tell without.
    assert np.abs(linear - slope[1:]).max() > 0.05
