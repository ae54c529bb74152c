"""Constrained fits on problems in closed form."""

import numpy as np
import pytest
from problems import (
    EASY,
    IG4,
    Cliff,
    ClosedForm,
    active_bounds,
    kinked,
    linear,
    many_kinks,
    plain_parameters,
    rosenbrock,
    sloppy_springs,
)

from identknee.calibrate.bounded_least_squares import (
    ConstrainedFit,
    minimise,
    solve_constrained,
    walk_to_constraint,
)
from identknee.calibrate.problem import (
    Evaluation,
    Evaluator,
    ParameterQuantity,
    UserQuantity,
    evaluate,
)
from identknee.runs.record import Outcome

# The deviance may be off by its tolerance of 1e-8; a difference over 1e-3 by 1e-5 of that.
TOLERANCE = 1e-8
TIGHT = 1e-13


@pytest.mark.parametrize("problem", EASY, ids=lambda x: x.name)
def test_without_a_constraint_it_finds_the_minimum(problem: ClosedForm) -> None:
    found = minimise(Evaluator(problem), problem.start)
    assert found.outcome is Outcome.MINIMUM
    assert found.evaluation.deviance == pytest.approx(2.0 * problem.lowest, abs=TOLERANCE)


@pytest.mark.parametrize("problem", EASY, ids=lambda x: x.name)
@pytest.mark.parametrize("distance", [-0.3, 0.4])
def test_a_held_parameter_is_held_and_the_rest_is_fitted(
    problem: ClosedForm, distance: float
) -> None:
    first = ParameterQuantity(parameters=problem.parameters, name=problem.parameters.names[0])
    target = max(problem.minimum[0] + distance, problem.parameters.lower[0])

    def at(value: float) -> ConstrainedFit:
        return solve_constrained(
            Evaluator(problem), problem.minimum, quantity=first, target=value, tolerance=TIGHT
        )

    found, step = at(target), 1e-4
    assert found.outcome is Outcome.MINIMUM
    assert found.is_on_target
    assert found.value == target == found.evaluation.theta[0]
    if target > problem.parameters.lower[0]:
        # Third derivatives of these problems, times the step squared.
        above, below = at(target + step), at(target - step)
        slope = (above.evaluation.deviance - below.evaluation.deviance) / (2 * step)
        assert found.multiplier == pytest.approx(slope, rel=1e-5, abs=1e-6)
    free = solve_constrained(Evaluator(problem), problem.start, quantity=first, target=target)
    assert free.evaluation.deviance >= found.evaluation.deviance - TOLERANCE


def test_the_tangent_is_the_path_of_a_linear_problem() -> None:
    problem = linear()
    first = ParameterQuantity(parameters=problem.parameters, name="x0.value_pct")
    ends = [
        solve_constrained(Evaluator(problem), problem.start, quantity=first, target=value)
        for value in (0.0, 1.0)
    ]
    np.testing.assert_allclose(
        ends[0].tangent, ends[1].evaluation.theta - ends[0].evaluation.theta, atol=1e-9
    )


def test_parameters_at_bounds_stay_in_the_tangent() -> None:
    problem = active_bounds()
    second = ParameterQuantity(parameters=problem.parameters, name="x1.value_pct")
    found = solve_constrained(Evaluator(problem), problem.start, quantity=second, target=0.5)
    assert found.is_held.tolist() == [True, False, True]
    np.testing.assert_array_equal(found.tangent, [0.0, 1.0, 0.0])


def test_a_curved_constraint_is_met() -> None:
    """The nearest point of the circle of radius 2 to (3, 4) is (1.2, 1.6), 3 away."""
    problem = _distance_from(np.array([3.0, 4.0]))
    radius = UserQuantity(name="r2", unit="", function=lambda x: float(x @ x))
    found = solve_constrained(Evaluator(problem), np.array([3.0, 4.0]), quantity=radius, target=4.0)
    assert found.outcome is Outcome.MINIMUM
    assert found.is_on_target
    np.testing.assert_allclose(found.evaluation.theta, [1.2, 1.6], atol=1e-4)
    assert found.evaluation.deviance == pytest.approx(9.0, abs=1e-6)
    # d (5 - r)^2 / d r^2 = -(5 - r) / r.
    assert found.multiplier == pytest.approx(-1.5, rel=1e-4)


def test_out_of_reach_it_ends_at_the_end_of_the_range() -> None:
    problem = _distance_from(np.array([3.0, 4.0]))
    total = UserQuantity(name="sum", unit="", function=lambda x: float(x.sum()))
    found = solve_constrained(Evaluator(problem), np.zeros(2), quantity=total, target=99.0)
    assert not found.is_on_target
    assert found.outcome is Outcome.MINIMUM
    np.testing.assert_array_equal(found.evaluation.theta, [10.0, 10.0])


def test_it_stops_at_a_cliff_and_says_so() -> None:
    wall = Cliff(problem=_distance_from(np.array([3.0, 4.0])), beyond=lambda x: x[1] - 2.0)
    first = ParameterQuantity(parameters=wall.parameters, name="x0.value_pct")
    found = solve_constrained(Evaluator(wall), np.zeros(2), quantity=first, target=3.0)
    assert found.outcome is Outcome.CLIFF
    # What the shortest step, 1e-7 of a standard deviation, leaves of the way.
    assert found.evaluation.deviance == pytest.approx(4.0, abs=1e-5)


def test_a_start_without_a_prediction_is_told() -> None:
    wall = Cliff(problem=linear(), beyond=lambda _: 1.0)
    found = minimise(Evaluator(wall), np.zeros(3))
    assert found.outcome is Outcome.START_FAILED
    assert not found.evaluation.is_finite


def test_a_target_is_walked_to_where_the_start_on_it_has_no_prediction() -> None:
    """The corridor with a prediction is oblique: put on target, the start leaves it."""
    valley = ClosedForm(
        name="corridor",
        parameters=plain_parameters(2),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array([0.3 * x[0], x[1] - 2.0 * x[0]]),
        jacobian_at=lambda _: np.array([[0.3, 0.0], [-2.0, 1.0]]),
    )
    problem = Cliff(problem=valley, beyond=lambda x: abs(x[1] - 2.0 * x[0]) - 1.0)
    first = ParameterQuantity(parameters=problem.parameters, name="x0.value_pct")
    put = solve_constrained(Evaluator(problem), np.zeros(2), quantity=first, target=3.0)
    assert put.outcome is Outcome.START_FAILED
    walked = walk_to_constraint(Evaluator(problem), np.zeros(2), quantity=first, target=3.0)
    assert walked.is_on_target
    np.testing.assert_allclose(walked.evaluation.theta, [3.0, 6.0], atol=1e-4)


def test_the_budget_ends_it() -> None:
    found = minimise(Evaluator(sloppy_springs(), budget=2), IG4)
    assert found.outcome is Outcome.BUDGET
    assert found.n_simulations == 2
    assert found.evaluation.is_finite


def test_a_good_start_takes_few_simulations() -> None:
    """Two to four from a tenth of a typical step away."""
    problem = sloppy_springs(noise=0.05)
    best = minimise(Evaluator(problem), problem.start).evaluation.theta
    first = ParameterQuantity(parameters=problem.parameters, name="ACL.stiffness_kN")
    found = solve_constrained(Evaluator(problem), best, quantity=first, target=best[0] + 0.3)
    assert found.n_simulations <= 4


def test_a_minimum_on_a_kink_takes_few_simulations() -> None:
    """The last one confirms the kink."""
    problem = kinked()
    found = minimise(Evaluator(problem), problem.start, tolerance=1e-4)
    assert found.outcome is Outcome.MINIMUM
    assert found.evaluation.deviance == pytest.approx(2.0 * problem.lowest, abs=1e-4)
    assert found.n_simulations <= 9


@pytest.mark.parametrize("seed", [6, 15, 27])
def test_a_model_from_far_away_does_not_end_a_search(seed: int) -> None:
    """At some points such a model is as high as the deviance, and rises where that falls."""
    problem = many_kinks(seed)
    found = minimise(Evaluator(problem), problem.start, tolerance=1e-6)
    assert found.outcome is Outcome.MINIMUM
    ways = np.random.default_rng(0).standard_normal((200, 3))
    ways *= 0.03 / np.linalg.norm(ways, axis=1)[:, None]
    around = [evaluate(problem, found.evaluation.theta + way).deviance for way in ways]
    assert min(around) > found.evaluation.deviance


def test_a_search_ends_at_the_first_simulation_that_is_enough() -> None:
    problem = rosenbrock()
    asked: list[float] = []

    def is_enough(at: Evaluation) -> bool:
        asked.append(at.deviance)
        return len(asked) == 3

    whole = minimise(Evaluator(problem), problem.start)
    found = minimise(Evaluator(problem), problem.start, is_enough=is_enough)
    assert found.outcome is Outcome.VALLEY
    assert found.n_simulations < whole.n_simulations
    assert found.evaluation.deviance == asked[-1] > whole.evaluation.deviance


def test_where_nothing_changes_the_residuals_it_goes_by_typical_steps() -> None:
    """A decay so far gone that squares of one over its slopes would overflow."""
    decay = ClosedForm(
        name="decay",
        parameters=plain_parameters(2, 0.0, 900.0),
        start=np.full(2, 360.0),
        minimum=np.full(2, 360.0),
        lowest=0.0,
        residuals_at=lambda x: np.exp(-x),
        jacobian_at=lambda x: np.diag(-np.exp(-x)),
    )
    first = ParameterQuantity(parameters=decay.parameters, name=decay.parameters.names[0])
    found = solve_constrained(Evaluator(decay), decay.start, quantity=first, target=362.0)
    assert found.outcome is Outcome.MINIMUM
    assert found.value == 362.0
    np.testing.assert_allclose(found.tangent, [1.0, 0.0])


def _distance_from(target: np.ndarray) -> ClosedForm:
    return ClosedForm(
        name="distance",
        parameters=plain_parameters(2),
        start=np.zeros(2),
        minimum=target,
        lowest=0.0,
        residuals_at=lambda x: x - target,
        jacobian_at=lambda _: np.eye(2),
    )
