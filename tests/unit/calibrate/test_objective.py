import numpy as np
import pytest
from problems import Cliff, linear

from identknee.calibrate.objective import Ended, Objective
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome


def test_value_is_half_the_sum_of_squares() -> None:
    problem = linear()
    objective = Objective(problem, budget=10)
    residuals = problem.residuals(problem.start)
    assert objective.value(problem.start) == pytest.approx(0.5 * np.sum(residuals**2), rel=1e-14)


def test_a_simulation_is_an_evaluation_at_a_new_theta() -> None:
    problem = linear()
    told: list[int] = []
    objective = Objective(problem, budget=10, on_simulation=told.append)
    objective.value(problem.minimum)
    objective.residuals(problem.minimum)
    objective.jacobian(problem.minimum)
    assert objective.n_simulations == 1
    objective.value(problem.start)
    objective.value(problem.minimum)
    assert objective.n_simulations == 2, "the best point is remembered"
    assert told == [1, 1]


def test_history_holds_the_improvements() -> None:
    problem = linear()
    objective = Objective(problem, budget=10)
    far = problem.minimum + 5
    for theta in (problem.start, far, problem.minimum):
        objective.value(theta)
    assert [number for number, _ in objective.history] == [1, 3]
    assert objective.history[-1][1] == objective.best_value
    np.testing.assert_array_equal(objective.best_theta, problem.minimum)


def test_no_prediction_is_infinite_and_never_the_best() -> None:
    problem = linear()
    objective = Objective(Cliff(problem=problem, beyond=lambda _: 1.0), budget=10)
    assert objective.value(problem.start) == np.inf
    assert np.all(np.isinf(objective.residuals(problem.start)))
    assert objective.best_theta is None
    assert objective.history == []


def test_one_residual_that_is_not_a_number_spoils_all() -> None:
    problem = linear()

    class Broken:
        parameters = problem.parameters
        jacobian = problem.jacobian

        def residuals(self, theta: Array) -> Array:
            residuals = problem.residuals(theta)
            residuals[3] = np.nan
            return residuals

    objective = Objective(Broken(), budget=2)
    assert np.all(np.isinf(objective.residuals(problem.start)))


def test_budget_ends_the_search() -> None:
    problem = linear()
    objective = Objective(problem, budget=1)
    objective.value(problem.start)
    with pytest.raises(Ended) as ended:
        objective.value(problem.minimum)
    assert ended.value.outcome is Outcome.BUDGET
    assert objective.n_simulations == 1


def test_what_was_remembered_does_not_change_with_the_callers_array() -> None:
    problem = linear()
    objective = Objective(problem, budget=5)
    theta = np.array(problem.start)
    objective.value(theta)
    theta += 1.0
    np.testing.assert_array_equal(objective.best_theta, problem.start)
    objective.value(theta)
    assert objective.n_simulations == 2
