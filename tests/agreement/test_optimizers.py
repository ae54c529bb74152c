"""Every optimizer behind `fit`, on every problem whose minimum is known."""

import numpy as np
import pytest
from problems import EASY, disc_in_the_way, linear, sloppy_springs
from slow_cases import some_slow

from identknee.calibrate.fit import METHODS, fit
from identknee.runs.record import Outcome

pytest.importorskip("cma")
pytest.importorskip("pymoo")

# How much above the minimum a method may end: two to three times the worst of ten seeds, measured.
# Annealing and the genetic algorithm refine slowly; the eight springs have a sloppy valley, and
# Rosenbrock's (12 at its start) holds annealing up in two runs of ten.
ABOVE_MINIMUM = {
    "least-squares": {
        "linear": 1e-15,
        "rosenbrock": 1e-20,
        "active bounds": 1e-13,
        "springs": 1e-20,
    },
    "complex": {"linear": 2e-7, "rosenbrock": 0.5, "springs": 0.08},
    "genetic": {"linear": 0.006, "rosenbrock": 0.15, "active bounds": 3e-6, "springs": 0.2},
    "particle-swarm": {"linear": 1e-9, "rosenbrock": 4e-4, "active bounds": 1e-9, "springs": 0.1},
    "cma-es": {"linear": 5e-7, "rosenbrock": 3e-8, "active bounds": 2e-6, "springs": 6e-8},
    "annealing": {"linear": 1e-5, "rosenbrock": 5.0, "active bounds": 4e-6, "springs": 1.0},
}
PROBLEMS = {problem.name.removeprefix("sloppy "): problem for problem in EASY}
PAIRS = [(method, name) for method, names in ABOVE_MINIMUM.items() for name in names]


def test_every_method_is_here() -> None:
    assert set(ABOVE_MINIMUM) == set(METHODS)


@pytest.mark.parametrize("seed", some_slow([0, 1], [1]))
@pytest.mark.parametrize(("method", "name"), PAIRS)
def test_ends_near_the_minimum(method: str, name: str, seed: int) -> None:
    problem = PROBLEMS[name]
    end = fit(problem, problem.start, method=method, seed=seed)
    assert end.objective <= problem.lowest + ABOVE_MINIMUM[method][name]
    assert end.outcome in {Outcome.MINIMUM, Outcome.SPREAD, Outcome.BUDGET}


def test_complex_knows_no_bound_but_the_floor_of_stiffnesses() -> None:
    problem = PROBLEMS["active bounds"]
    end = fit(problem, problem.start, method="complex")
    # Without its bounds the problem has the minimum 0 at (-1, 2, 9).
    np.testing.assert_allclose(end.theta, [-1.0, 2.0, 9.0], atol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_the_same_seed_gives_the_same_fit(method: str) -> None:
    problem = sloppy_springs()
    first, second = (fit(problem, problem.start, method=method, budget=300) for _ in range(2))
    np.testing.assert_array_equal(first.theta, second.theta)
    np.testing.assert_array_equal(first.history, second.history)


@pytest.mark.parametrize("method", [method for method in METHODS if method != "least-squares"])
def test_another_seed_gives_another_search(method: str) -> None:
    problem = sloppy_springs()
    first, second = (
        fit(problem, problem.start, method=method, seed=seed, budget=100) for seed in (0, 1)
    )
    assert first.objective != second.objective


@pytest.mark.parametrize("method", METHODS)
def test_the_budget_is_kept_exactly_and_the_result_is_consistent(method: str) -> None:
    problem = sloppy_springs()
    end = fit(problem, problem.start, method=method, budget=57)
    assert end.n_simulations <= 57
    if end.outcome is Outcome.BUDGET:
        assert end.n_simulations == 57
    assert end.history[-1, 1] == end.objective
    assert np.all(np.diff(end.history[:, 0]) > 0)
    assert np.all(np.diff(end.history[:, 1]) < 0)
    own = 0.5 * np.sum(problem.residuals(end.theta) ** 2)
    assert end.objective == pytest.approx(own, rel=1e-12)
    assert end.gradient_norm is not None


@pytest.mark.parametrize("method", [method for method in METHODS if method != "complex"])
def test_bounds_hold(method: str) -> None:
    problem = PROBLEMS["active bounds"]
    end = fit(problem, problem.start, method=method, budget=400)
    assert np.all(end.theta >= problem.parameters.lower)
    assert np.all(end.theta <= problem.parameters.upper)


@pytest.mark.parametrize("method", METHODS)
def test_infinite_objectives_are_survived(method: str) -> None:
    cliff = disc_in_the_way()
    # A box that the disc cuts into: some of the first candidates have no prediction.
    end = fit(cliff, [-2.5, 0.3], method=method)
    start = 0.5 * np.sum(cliff.residuals(np.array([-2.5, 0.3])) ** 2)
    assert np.isfinite(end.objective)
    assert cliff.beyond(end.theta) <= 0
    assert end.objective < start


@pytest.mark.parametrize("method", METHODS)
def test_fixed_parameters_and_priors_work_for_all(method: str) -> None:
    problem = linear()
    held = problem.parameters.names[1]
    end = fit(problem, problem.start, method=method, fixed=(held,), priors=True, budget=300)
    assert end.theta[1] == problem.start[1]
    own = 0.5 * np.sum(problem.residuals(end.theta) ** 2)
    others = end.theta[[0, 2]] / 2.0
    prior = 0.5 * np.sum(others**2) + 0.5 * (end.theta[1] / 2.0) ** 2
    assert end.objective == pytest.approx(own + prior, rel=1e-12)
