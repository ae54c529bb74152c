from dataclasses import replace

import numpy as np
import pytest
from problems import Cliff, ClosedForm, linear, sloppy_springs

from identknee.calibrate.problem import Evaluation, Evaluator, SearchEnded, evaluate, jump
from identknee.runs.declare import Array
from identknee.runs.record import Outcome


@pytest.fixture
def springs() -> ClosedForm:
    return sloppy_springs(noise=0.1)


def test_deviance_is_the_sum_of_squares() -> None:
    problem = linear()
    evaluator = Evaluator(problem, budget=10)
    residuals = problem.residuals(problem.start)
    assert evaluator.deviance(problem.start) == pytest.approx(np.sum(residuals**2), rel=1e-14)


def test_residuals_and_jacobian_are_one_simulation(springs: ClosedForm) -> None:
    evaluator = Evaluator(springs)
    first = evaluator(springs.start)
    again = evaluator(np.array(springs.start))
    assert again is first
    assert evaluator.n_simulations == 1
    evaluator(springs.minimum)
    assert evaluator.n_simulations == 2


def test_an_evaluation_made_before_counts_and_costs_nothing(springs: ClosedForm) -> None:
    asked: list[Array] = []

    def residuals(theta: Array) -> Array:
        asked.append(theta)
        return springs.residuals_at(theta)

    before = evaluate(springs, springs.minimum)
    evaluator = Evaluator(replace(springs, residuals_at=residuals), known=[before])
    assert evaluator(np.array(springs.minimum)) is before
    assert evaluator.n_simulations == 1
    assert not asked
    assert evaluator.best_deviance == before.deviance
    evaluator(springs.start)
    assert len(asked) == 1


def test_the_gradient_of_the_deviance_is_exact(springs: ClosedForm) -> None:
    found = evaluate(springs, springs.start)
    assert found.deviance == pytest.approx(float(np.sum(springs.residuals(springs.start) ** 2)))
    step = 1e-6

    def deviance(theta: Array) -> float:
        return evaluate(springs, theta).deviance

    differences = [
        (deviance(springs.start + e) - deviance(springs.start - e)) / (2 * step)
        for e in step * np.eye(springs.parameters.n)
    ]
    # Central differences: rounding of the deviance over twice the step.
    bound = 1e-5 * max(1.0, np.abs(found.gradient).max())
    np.testing.assert_allclose(found.gradient, differences, atol=bound)


def test_no_prediction_has_infinite_deviance_and_asks_for_no_derivatives(
    springs: ClosedForm,
) -> None:
    found = evaluate(Cliff(problem=springs, beyond=lambda theta: 1.0), springs.start)
    assert not found.is_finite
    assert found.deviance == np.inf


def test_a_simulation_is_an_evaluation_at_a_new_theta() -> None:
    problem = linear()
    told: list[int] = []
    evaluator = Evaluator(problem, budget=10, on_simulation=told.append)
    evaluator.deviance(problem.minimum)
    evaluator.residuals(problem.minimum)
    evaluator(problem.minimum)
    assert evaluator.n_simulations == 1
    evaluator.deviance(problem.start)
    evaluator.deviance(problem.minimum)
    assert evaluator.n_simulations == 2, "the best point is remembered"
    assert told == [1, 1]


def test_a_search_that_joins_one_which_found_as_much_is_left(springs: ClosedForm) -> None:
    evaluator = Evaluator(springs, ends=[evaluate(springs, springs.minimum)])
    evaluator(springs.start)
    with pytest.raises(SearchEnded):
        evaluator(springs.minimum)
    assert evaluator.n_simulations == 1


def test_a_search_that_found_more_goes_where_it_likes(springs: ClosedForm) -> None:
    evaluator = Evaluator(springs, ends=[evaluate(springs, springs.start)])
    evaluator(springs.minimum)
    evaluator(springs.start)
    assert evaluator.n_simulations == 2


def test_history_holds_the_improvements() -> None:
    problem = linear()
    evaluator = Evaluator(problem, budget=10)
    far = problem.minimum + 5
    for theta in (problem.start, far, problem.minimum):
        evaluator.deviance(theta)
    assert [number for number, _ in evaluator.history] == [1, 3]
    assert evaluator.history[-1][1] == evaluator.best_deviance
    np.testing.assert_array_equal(evaluator.best_theta, problem.minimum)


def test_no_prediction_is_infinite_and_never_the_best() -> None:
    problem = linear()
    evaluator = Evaluator(Cliff(problem=problem, beyond=lambda _: 1.0), budget=10)
    assert evaluator.deviance(problem.start) == np.inf
    assert np.all(np.isinf(evaluator.residuals(problem.start)))
    assert evaluator.best_theta is None
    assert evaluator.history == []


def test_one_residual_that_is_not_a_number_spoils_all() -> None:
    problem = linear()

    class Broken:
        parameters = problem.parameters
        jacobian = problem.jacobian

        def residuals(self, theta: Array) -> Array:
            residuals = problem.residuals(theta)
            residuals[3] = np.nan
            return residuals

    evaluator = Evaluator(Broken(), budget=2)
    assert np.all(np.isinf(evaluator.residuals(problem.start)))


def test_budget_ends_the_search() -> None:
    problem = linear()
    evaluator = Evaluator(problem, budget=1)
    evaluator.deviance(problem.start)
    with pytest.raises(SearchEnded) as ended:
        evaluator.deviance(problem.minimum)
    assert ended.value.outcome is Outcome.BUDGET
    assert evaluator.n_simulations == 1


def test_what_was_remembered_does_not_change_with_the_callers_array() -> None:
    problem = linear()
    evaluator = Evaluator(problem, budget=5)
    theta = np.array(problem.start)
    evaluator.deviance(theta)
    theta += 1.0
    np.testing.assert_array_equal(evaluator.best_theta, problem.start)
    evaluator.deviance(theta)
    assert evaluator.n_simulations == 2


def test_a_jump_is_a_residual_without_derivatives_that_differs() -> None:
    def at(last: float, slope: float) -> Evaluation:
        return Evaluation(
            theta=np.zeros(1),
            residuals=np.array([1.0, last]),
            jacobian=np.array([[2.0], [slope]]),
        )

    assert jump(at(0.0, 0.0), at(5.0, 0.0)) == 25.0
    assert jump(at(5.0, 0.0), at(0.0, 0.0)) == -25.0
    # What has a slope changes for a reason, and rounding is no jump.
    assert jump(at(0.0, 0.0), at(5.0, 1.0)) == 0.0
    assert jump(at(1.0, 0.0), at(1.0 + 1e-9, 0.0)) == 0.0
