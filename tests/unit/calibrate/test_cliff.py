import numpy as np
import pytest
from problems import (
    IG4,
    Cliff,
    disc_in_the_way,
    linear,
    sloppy_springs,
    springs_with_a_ball,
    wall_before_the_minimum,
)

from identknee.calibrate import least_squares
from identknee.calibrate.fit import fit
from identknee.calibrate.least_squares import descent_around_cliff
from identknee.calibrate.problem import Evaluator
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

SCALES = np.array([3.0] * 4 + [2.0] * 4)


def without_a_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(least_squares, "descent_around_cliff", lambda *_: None)


def test_the_straight_descent_ends_on_the_disc(monkeypatch: pytest.MonkeyPatch) -> None:
    without_a_way(monkeypatch)
    cliff = disc_in_the_way()
    end = fit(cliff, cliff.problem.start)
    assert end.outcome is Outcome.CLIFF
    # It went as close as a ten-thousandth of a typical step (2 %) along a steep approach.
    assert 0 <= np.linalg.norm(end.theta) - 2.0 < 1e-2


def test_the_fit_goes_around_the_disc() -> None:
    cliff = disc_in_the_way()
    end = fit(cliff, cliff.problem.start)
    assert end.outcome is Outcome.MINIMUM
    np.testing.assert_allclose(end.theta, cliff.problem.minimum, rtol=1e-9)
    assert end.n_simulations < 200


def test_a_way_around_is_feasible_and_lower() -> None:
    cliff = disc_in_the_way()
    evaluator = Evaluator(cliff, budget=500)
    before = np.array([-2.0001, -0.1])
    value = evaluator.deviance(before)
    around = descent_around_cliff(evaluator, before, np.random.default_rng(0))
    assert around is not None
    assert cliff.beyond(around) <= 0
    assert evaluator.deviance(around) < value


def test_no_way_around_a_wall_at_its_lowest_point() -> None:
    cliff = wall_before_the_minimum()
    end = fit(cliff, cliff.problem.start)
    evaluator = Evaluator(cliff, budget=500)
    evaluator.deviance(end.theta)
    assert descent_around_cliff(evaluator, end.theta, np.random.default_rng(1)) is None


def test_no_way_from_a_point_without_slope() -> None:
    problem = linear()
    flat = np.zeros((8, 3))

    class Flat:
        parameters = problem.parameters
        residuals = problem.residuals

        def jacobian(self, theta: Array) -> Array:
            return flat

    evaluator = Evaluator(Flat(), budget=5)
    evaluator.deviance(problem.start)
    assert descent_around_cliff(evaluator, problem.start, np.random.default_rng(0)) is None


def test_one_parameter_has_no_sideways() -> None:
    problem = linear(1)
    wall = 0.5 * (problem.start + problem.minimum)
    side = np.sign(problem.minimum - problem.start)
    cliff = Cliff(problem=problem, beyond=lambda x: float((side * (x - wall))[0]))
    assert fit(cliff, problem.start).outcome is Outcome.CLIFF


def ball_case(seed: int) -> tuple[Array, Cliff]:
    """Springs from a random start, a ball close to the middle of the straight way."""
    rng = np.random.default_rng(seed)
    problem = sloppy_springs()
    low, high = problem.parameters.lower + 0.1, problem.parameters.upper - 0.1
    start = np.clip(problem.minimum + 1.5 * SCALES * rng.normal(size=8), low, high)
    way = (problem.minimum - start) / SCALES
    distance = np.linalg.norm(way)
    aside = rng.normal(size=8)
    aside -= (aside @ way) * way / distance**2
    radius = 0.42 * distance
    center = start / SCALES + 0.55 * way + 0.5 * radius * aside / np.linalg.norm(aside)

    def beyond(theta: Array) -> float:
        return float(radius - np.linalg.norm(theta / SCALES - center))

    return start, Cliff(problem=problem, beyond=beyond)


def test_eight_parameters_get_around_balls_that_stop_the_plain_descent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cases = [ball_case(seed) for seed in range(20)]
    around = [fit(cliff, start) for start, cliff in cases]
    without_a_way(monkeypatch)
    plain = [fit(cliff, start) for start, cliff in cases]
    assert sum(end.outcome is Outcome.CLIFF for end in plain) >= 4, "the balls are in the way"
    assert all(end.outcome is Outcome.MINIMUM for end in around)
    assert all(end.gradient_norm is not None and end.gradient_norm < 1e-8 for end in around)
    # Two of the springs may end slack, which is a minimum too: the reference is not the only one.
    reference = sloppy_springs().minimum
    assert sum(np.allclose(end.theta, reference, rtol=0, atol=1e-9) for end in around) >= 18
    assert max(end.n_simulations for end in around) < 500


@pytest.mark.parametrize("seed", range(3))
def test_the_way_is_the_same_for_the_same_seed(seed: int) -> None:
    cliff = springs_with_a_ball(IG4)
    first, second = (fit(cliff, IG4, seed=seed) for _ in range(2))
    np.testing.assert_array_equal(first.history, second.history)
