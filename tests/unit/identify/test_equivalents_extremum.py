"""Extrema over a region, against formulas, a global search and profiles."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from problems import Cliff, Linear, linear, plain_parameters, rosenbrock, sloppy_springs
from scipy.optimize import differential_evolution

from identknee.calibrate.bounded_least_squares import solve_constrained
from identknee.calibrate.problem import Evaluator, ParameterQuantity, UserQuantity
from identknee.identify.region import (
    INSIDE_TOLERANCE,
    Extreme,
    ExtremumEnd,
    RegionView,
    extremise,
    farthest_pair,
    noise_region,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

VALUE = 1e-6


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("index", range(8))
def test_an_extremum_is_the_end_of_a_profile(index: int, sign: float) -> None:
    """Without noise the least deviance with a parameter held at its extremum is the limit."""
    problem = sloppy_springs()
    limit = 0.01
    view = RegionView(noise_region(problem, problem.minimum, limit=limit))
    quantity = ParameterQuantity(
        parameters=problem.parameters, name=problem.parameters.names[index]
    )
    found = extremise(view, quantity, problem.minimum, sign=sign)
    assert found.end is ExtremumEnd.LIMIT
    assert view.n_simulations < 40
    held = solve_constrained(Evaluator(problem), found.theta, quantity=quantity, target=found.value)
    assert held.evaluation.deviance == pytest.approx(limit, rel=1e-4)
    cold = solve_constrained(
        Evaluator(problem), problem.minimum, quantity=quantity, target=found.value
    )
    assert cold.evaluation.deviance == pytest.approx(limit, rel=1e-4)


def test_a_curved_quantity_on_a_banana_against_a_global_search() -> None:
    problem = rosenbrock()
    view = RegionView(noise_region(problem, problem.minimum))
    quantity = UserQuantity(
        name="bent",
        unit="",
        function=lambda x: float(np.sin(x[0]) + x[1] ** 2),
        gradient=lambda x: np.array([np.cos(x[0]), 2 * x[1]]),
    )
    for sign in (-1.0, 1.0):

        def cost(x: Array, sign: float = sign) -> float:
            excess = max(view(x).largest - 1.0, 0.0)
            return -sign * quantity.evaluate(x)[0] + 1e3 * excess

        found = extremise(view, quantity, problem.minimum, sign=sign)
        everywhere = differential_evolution(
            cost, [(-1.0, 3.0), (-2.0, 6.0)], rng=1, tol=1e-10, maxiter=150, polish=False
        )
        assert sign * found.value >= -everywhere.fun - 1e-3
        assert found.value == pytest.approx(-sign * everywhere.fun, rel=2e-3, abs=1e-6)


def test_the_farthest_pair_of_random_directions_is_no_farther() -> None:
    problem = linear()
    view = RegionView(noise_region(problem, problem.minimum))
    found = farthest_pair(view, problem.minimum, problem.minimum + 0.01)
    covariance = np.linalg.inv(
        problem.jacobian(problem.minimum).T @ problem.jacobian(problem.minimum)
    )
    longest = 2.0 * np.sqrt(np.linalg.eigvalsh(covariance)[-1]) / 2.0
    assert found.value == pytest.approx(longest, rel=VALUE)
    turns = np.random.default_rng(2).normal(size=(20000, 3))
    matrix = problem.jacobian(problem.minimum)
    turns /= np.linalg.norm(turns @ matrix.T, axis=1, keepdims=True)
    assert np.linalg.norm(turns, axis=1).max() <= found.value * (1 + VALUE)


def test_a_quantity_inside_has_an_interior_extremum() -> None:
    problem = Linear(parameters=plain_parameters(2), matrix=np.eye(2), data=np.zeros(2))
    view = RegionView(noise_region(problem, np.zeros(2)))
    hill = UserQuantity(
        name="hill",
        unit="",
        function=lambda x: -float((x - 0.1) @ (x - 0.1)),
        gradient=lambda x: -2.0 * (x - 0.1),
    )
    found = extremise(view, hill, np.zeros(2), sign=1.0)
    assert found.end is ExtremumEnd.INTERIOR
    assert found.theta == pytest.approx([0.1, 0.1], abs=1e-4)
    assert found.largest < 1.0


def test_a_quantity_that_does_not_change_stays_where_it_is() -> None:
    problem = linear()
    view = RegionView(noise_region(problem, problem.minimum))
    slack = UserQuantity(
        name="slack", unit="N", function=lambda _: 0.0, gradient=lambda x: np.zeros_like(x)
    )
    found = extremise(view, slack, problem.minimum, sign=1.0)
    assert found.end is ExtremumEnd.INTERIOR
    assert np.array_equal(found.theta, problem.minimum)


def test_a_cliff_is_named() -> None:
    problem = linear()
    center = problem.minimum
    cut = Cliff(problem=problem, beyond=lambda x: float(x[0] - center[0]) - 0.1)
    view = RegionView(noise_region(cut, center))
    quantity = ParameterQuantity(parameters=problem.parameters, name="x0.value_pct")
    found = extremise(view, quantity, center, sign=1.0)
    assert found.end is ExtremumEnd.CLIFF
    assert found.value == pytest.approx(center[0] + 0.1, abs=1e-5)


def test_a_start_without_prediction_is_refused() -> None:
    problem = linear()
    cut = Cliff(problem=problem, beyond=lambda x: float(x[0] - problem.minimum[0]) - 0.1)
    view = RegionView(noise_region(cut, problem.minimum))
    quantity = ParameterQuantity(parameters=problem.parameters, name="x0.value_pct")
    with pytest.raises(ValueError, match=r"start.*prediction"):
        extremise(view, quantity, problem.minimum + 1.0, sign=1.0)


def test_every_end_has_a_sentence() -> None:
    assert all(end.sentence.endswith(".") for end in ExtremumEnd)


@dataclass(frozen=True)
class Fold:
    """Predictions with a crease along ``y = x^2``, as steep as it is."""

    steepness: float
    parameters: Parameters = field(default_factory=lambda: plain_parameters(2, -10.0, 10.0))

    def residuals(self, theta: Array) -> Array:
        """Shape ``(2,)``: the crease, and its other sides."""
        x, y = theta
        return np.array([0.1 * x + self.steepness * abs(y - x**2), 0.3 * (y - x**2) + 0.05 * x])

    def jacobian(self, theta: Array) -> Array:
        """Derivatives on the side of the crease on which theta lies."""
        x, y = theta
        side = self.steepness * np.where(y > x**2, 1.0, -1.0)
        return np.array([[0.1 - 2.0 * x * side, side], [0.05 - 0.6 * x, 0.3]])


def along_a_crease(steepness: float) -> tuple[Extreme, int]:
    """The largest x, and the simulations that it took."""
    problem = Fold(steepness)
    view = RegionView(noise_region(problem, np.zeros(2)))
    x = ParameterQuantity(parameters=problem.parameters, name=problem.parameters.names[0])
    return extremise(view, x, np.zeros(2), sign=1.0), view.n_simulations


def test_a_crease_is_followed_to_its_end() -> None:
    found, _ = along_a_crease(100.0)
    assert found.end is ExtremumEnd.LIMIT
    assert found.value == pytest.approx(np.sqrt(10.0), rel=1e-3)


def test_a_search_that_creeps_ends_and_says_so() -> None:
    found, n_simulations = along_a_crease(1e6)
    assert found.end is ExtremumEnd.CREASE
    assert n_simulations < 40


def test_a_search_that_ends_outside_is_pulled_back_inside() -> None:
    """It stops at 0.633, just beyond the limit, and was last inside at 0.492."""
    found, _ = along_a_crease(10.0**3.5)
    assert found.end is ExtremumEnd.BUDGET
    assert found.value > 0.63
    assert found.largest <= 1.0 + INSIDE_TOLERANCE
