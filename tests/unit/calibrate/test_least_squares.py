from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from problems import (
    IG2,
    IG4,
    Cliff,
    active_bounds,
    linear,
    plain_parameters,
    rosenbrock,
    sloppy_springs,
    wall_before_the_minimum,
)

from identknee.calibrate.fit import fit
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

# What the benchmark wants of noise-free data, in kN and %.
RECOVERY = 1e-9


ALONE, PAIR = plain_parameters(1), plain_parameters(2)


@dataclass(frozen=True, kw_only=True)
class Kinked:
    """A parabola and a wedge with their lowest point at 0."""

    slope: float = 0.01
    parameters: Parameters = ALONE

    def residuals(self, theta: Array) -> Array:
        return np.array([1.0 + self.slope * abs(theta[0]), 30.0 * theta[0]])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[self.slope if theta[0] > 0 else -self.slope], [30.0]])


@dataclass(frozen=True, kw_only=True)
class Bent:
    """A bent valley so narrow that a search creeps along it, beside a misfit that stays."""

    narrow: float = 1e4
    parameters: Parameters = PAIR

    def residuals(self, theta: Array) -> Array:
        x, y = theta
        return np.array([1e3, self.narrow * (y - x * x), 1.0 - x])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[0.0, 0.0], [-2.0 * self.narrow * theta[0], self.narrow], [-1.0, 0.0]])


def test_a_search_that_creeps_ends_in_a_valley() -> None:
    end = fit(Bent(), np.array([-3.0, 9.0]))
    assert end.outcome is Outcome.VALLEY
    assert end.n_simulations < 60


def test_scipy_shrinks_its_step_fourfold_after_residuals_without_prediction() -> None:
    """What the search for a cliff relies on, whichever scipy is installed."""
    tried: list[float] = []

    def residuals(x: Array) -> Array:
        tried.append(float(x[0]))
        return np.array([np.inf]) if x[0] > 1.0 else x - 4.0

    scipy.optimize.least_squares(
        residuals, [0.0], jac=lambda _: np.eye(1), bounds=(-9, 9), method="trf", max_nfev=4
    )
    steps = np.array(tried[1:])
    blocked = steps[:-1] > 1.0
    assert blocked.any()
    np.testing.assert_allclose((steps[1:] / steps[:-1])[blocked], 0.25, rtol=1e-6)


@pytest.mark.parametrize("start", [IG2, IG4], ids=["IG2", "IG4"])
def test_recovers_noise_free_springs(start: Any) -> None:
    problem = sloppy_springs()
    end = fit(problem, start)
    assert end.outcome is Outcome.MINIMUM
    assert np.max(np.abs(end.theta - problem.minimum)) < RECOVERY
    assert end.n_simulations <= 20


def test_starting_at_the_minimum_costs_at_most_one_step() -> None:
    problem = sloppy_springs()
    end = fit(problem, problem.minimum)
    assert end.outcome is Outcome.MINIMUM
    assert end.n_simulations <= 2


def test_noisy_springs_end_where_the_gradient_vanishes() -> None:
    end = fit(sloppy_springs(noise=0.1), IG4)
    assert end.outcome is Outcome.MINIMUM
    assert end.objective > 0.1
    # The objective is about 0.5, so its derivatives per typical step round at 1e-16; the last
    # Gauss-Newton step leaves what the curvature it neglects makes of 1e-6 of a typical step.
    assert end.gradient_norm is not None
    assert end.gradient_norm < 1e-6
    assert end.n_simulations <= 40


def test_active_bounds_are_met_exactly() -> None:
    problem = active_bounds()
    end = fit(problem, problem.start)
    assert end.outcome is Outcome.MINIMUM
    np.testing.assert_allclose(end.theta, problem.minimum, atol=1e-12)
    assert end.at_bounds == (problem.parameters.names[0], problem.parameters.names[2])


@pytest.mark.parametrize("start", [[0.0, 5.0, 0.0], [-3.0, 99.0, 5.0]])
def test_a_start_on_or_outside_the_bounds_is_moved_inside(start: Any) -> None:
    problem = active_bounds()
    end = fit(problem, start)
    assert end.outcome is Outcome.MINIMUM
    np.testing.assert_allclose(end.theta, problem.minimum, atol=1e-12)
    np.testing.assert_array_equal(end.start, start)


def test_a_start_without_prediction_fails_at_once() -> None:
    problem = Cliff(problem=linear(), beyond=lambda _: 1.0)
    end = fit(problem, problem.problem.start)
    assert end.outcome is Outcome.START_FAILED
    assert end.n_simulations == 1
    assert end.objective == np.inf
    np.testing.assert_array_equal(end.theta, end.start)


def test_a_wall_ends_the_fit_near_the_lowest_point_before_it() -> None:
    cliff = wall_before_the_minimum()
    problem = cliff.problem
    end = fit(cliff, problem.start)
    assert end.outcome is Outcome.CLIFF
    assert "cliff" in end.message
    assert cliff.beyond(end.theta) <= 0
    # Lowest point on the wall by its Lagrange conditions.
    normal = problem.minimum - problem.start
    hessian = problem.jacobian(problem.start).T @ problem.jacobian(problem.start)
    towards = np.linalg.solve(hessian, normal)
    on_wall = problem.minimum - towards * (normal @ normal / 2) / (normal @ towards)
    lowest = 0.5 * np.sum(problem.residuals(on_wall) ** 2)
    # A way on is only taken if it gains 1 % of what the linear model predicts.
    assert end.objective < lowest + 0.05 * (lowest - problem.lowest)
    assert end.n_simulations < 300


def test_budget_ends_the_descent() -> None:
    problem = rosenbrock()
    end = fit(problem, problem.start, budget=5)
    assert end.outcome is Outcome.BUDGET
    assert end.n_simulations == 5
    assert end.objective == end.history[-1, 1]


def test_residuals_that_lie_about_their_derivatives_end_in_a_valley() -> None:
    problem = rosenbrock()

    class Lying:
        parameters = problem.parameters
        residuals = problem.residuals

        def jacobian(self, theta: Array) -> Array:
            return -problem.jacobian(theta)

    end = fit(Lying(), problem.start)
    assert end.outcome is Outcome.VALLEY
    assert end.gradient_norm is not None
    assert end.gradient_norm > 1.0
    assert end.n_simulations < 100


def test_derivatives_that_are_not_finite_end_in_a_valley() -> None:
    problem = rosenbrock()

    class Broken:
        parameters = problem.parameters
        residuals = problem.residuals

        def jacobian(self, theta: Array) -> Array:
            return np.full((2, 2), np.nan)

    end = fit(Broken(), problem.start)
    assert end.outcome is Outcome.VALLEY
    assert end.gradient_norm is None


def test_a_minimum_on_a_kink_is_a_minimum() -> None:
    """As where a contact point just touches: the slopes of both sides point at each other."""
    end = fit(Kinked(), np.array([0.7]))
    assert end.outcome is Outcome.MINIMUM
    assert abs(end.theta[0]) < 2e-5
    assert end.gradient_norm is not None
    assert end.gradient_norm > 1e-3


def test_nuisances_put_up_with_sharper_kinks() -> None:
    """With priors the deviance is one of the noise, of which the slopes predict a hundredth here.

    The predicted reduction is the slope squared over that of the other residual.
    """
    alone = Kinked(slope=2.0)
    beside = Kinked(slope=2.0, parameters=ALONE.as_nuisances())
    too_sharp = Kinked(slope=4.0, parameters=ALONE.as_nuisances())
    outcomes = [fit(x, np.array([0.7])).outcome for x in (alone, beside, too_sharp)]
    assert outcomes == [Outcome.VALLEY, Outcome.MINIMUM, Outcome.VALLEY]
