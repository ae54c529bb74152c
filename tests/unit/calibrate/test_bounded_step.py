"""The active-set step against scipy and against what defines a minimum."""

import numpy as np
import pytest
import scipy.optimize

from identknee.calibrate.bounded_least_squares import (
    KinkModels,
    _least_norm_step,
    bounded_step,
    feasible_point,
    minimise_max_model,
    nearest_attainable,
)
from identknee.calibrate.problem import LARGE, Evaluation

# Linear algebra of condition 100 at most.
CLOSE = 1e-9
SEEDS = range(25)


def _problem(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    matrix, data = rng.normal(size=(9, 5)), 3.0 * rng.normal(size=9)
    return matrix, data, -rng.exponential(size=5), rng.exponential(size=5), rng.normal(size=5)


@pytest.mark.parametrize("seed", SEEDS)
def test_without_a_plane_it_is_bounded_least_squares(seed: int) -> None:
    matrix, data, low, high, _ = _problem(seed)
    step = bounded_step(matrix, data, (low, high), None).step
    peer = scipy.optimize.lsq_linear(matrix, -data, (low, high), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(step, peer, atol=CLOSE)


@pytest.mark.parametrize("seed", SEEDS)
def test_on_a_plane_the_forces_balance(seed: int) -> None:
    """Karush, Kuhn and Tucker: the derivatives are the plane's, or push against a bound."""
    matrix, data, low, high, normal = _problem(seed)
    wanted = nearest_attainable(normal, (low, high), 0.4)
    found = bounded_step(matrix, data, (low, high), (normal, wanted))
    assert normal @ found.step == pytest.approx(wanted, abs=CLOSE)
    assert np.all((low <= found.step) & (found.step <= high))
    left = matrix.T @ (matrix @ found.step + data) - found.multiplier * normal
    free = ~found.is_held
    np.testing.assert_allclose(left[free], 0.0, atol=CLOSE)
    assert np.all(left[~free & (found.step == low)] >= -CLOSE)
    assert np.all(left[~free & (found.step == high)] <= CLOSE)


@pytest.mark.parametrize("loose", [0, 3])
def test_a_beginning_near_the_lowest_point_changes_nothing(
    loose: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With full rank and, where directions change nothing, without."""
    rng = np.random.default_rng(5)
    matrix, data = rng.normal(size=(120, 90)), 3.0 * rng.normal(size=120)
    if loose:
        matrix[:, :loose] = matrix[:, -loose:]
    bounds = -rng.exponential(size=90), rng.exponential(size=90)
    found = bounded_step(matrix, data, bounds, None)
    monkeypatch.setattr("identknee.calibrate.bounded_least_squares.LEAST_DIAGONAL", 1.0)
    monkeypatch.setattr("identknee.calibrate.bounded_least_squares.CLEAR", np.inf)
    peer = bounded_step(matrix, data, bounds, None)
    np.testing.assert_allclose(found.step, peer.step, atol=CLOSE)
    np.testing.assert_array_equal(found.is_held, peer.is_held)


@pytest.mark.parametrize("reach", [0.01, 0.3, 9.0])
def test_factors_saved_where_parameters_are_many_change_nothing(
    reach: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Many bounds active, some and none: a matrix, its triangle, on a plane, across a kink."""
    rng = np.random.default_rng(7)
    n = LARGE + 12
    sides = [_side(rng, n) for _ in range(3)]
    bounds = -reach * rng.exponential(size=n), reach * rng.exponential(size=n)
    kinks = KinkModels()
    for side in sides[1:]:
        kinks.remember(side)

    def found() -> list[np.ndarray]:
        models = kinks.models(sides[0], np.full(n, 0.5), length=1.0, slack=1e9)
        triangle = models[0]
        _, height = minimise_max_model(models, bounds, None, 1e-9)
        return [
            bounded_step(sides[0].jacobian, sides[0].residuals, bounds, None).step,
            bounded_step(triangle[:, :-1], triangle[:, -1], bounds, None).step,
            bounded_step(sides[0].jacobian, sides[0].residuals, bounds, (np.ones(n), 0.0)).step,
            np.array([len(models), height]),
        ]

    large = found()
    monkeypatch.setattr("identknee.calibrate.bounded_least_squares.LARGE", n)
    for here, peer in zip(large, found(), strict=True):
        np.testing.assert_allclose(here, peer, rtol=1e-8, atol=CLOSE)


@pytest.mark.parametrize("loose", [0, 3])
def test_the_least_norm_step_of_many_parameters_is_that_of_lstsq(loose: int) -> None:
    rng = np.random.default_rng(8)
    matrix, missing = rng.normal(size=(LARGE + 30, LARGE + 12)), rng.normal(size=LARGE + 30)
    if loose:
        matrix[:, :loose] = matrix[:, -loose:]
    exact, _, _, _ = np.linalg.lstsq(matrix, -missing, rcond=1e-12)
    np.testing.assert_allclose(_least_norm_step(matrix, missing, 1e-9), exact, atol=CLOSE)


def _side(rng: np.random.Generator, n: int) -> Evaluation:
    jacobian = np.vstack([rng.normal(size=(n + 40, n)) / np.sqrt(n), 0.3 * np.eye(n)])
    return Evaluation(
        theta=0.2 * rng.uniform(-1.0, 1.0, size=n),
        residuals=rng.normal(size=len(jacobian)),
        jacobian=jacobian,
    )


def test_the_multiplier_is_the_derivative_by_the_plane() -> None:
    matrix, data, low, high, normal = _problem(3)

    def half(wanted: float) -> float:
        step = bounded_step(matrix, data, (low, high), (normal, wanted)).step
        return 0.5 * float(np.sum((matrix @ step + data) ** 2))

    found = bounded_step(matrix, data, (low, high), (normal, 0.2))
    # Central differences of a parabola are exact but for rounding.
    assert found.multiplier == pytest.approx((half(0.201) - half(0.199)) / 0.002, rel=1e-8)


def test_directions_that_change_nothing_stay() -> None:
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = bounded_step(matrix, np.array([-2.0, 1.0]), (-np.full(3, 9.0), np.full(3, 9.0)), None)
    np.testing.assert_allclose(found.step, [2.0, 0.0, 0.0], atol=CLOSE)


def test_a_plane_out_of_reach_is_approached() -> None:
    normal, bounds = np.array([1.0, -2.0]), (np.zeros(2) - 1.0, np.ones(2))
    assert nearest_attainable(normal, bounds, 10.0) == 3.0
    assert nearest_attainable(normal, bounds, -10.0) == -3.0
    np.testing.assert_allclose(feasible_point(normal, bounds, 3.0), [1.0, -1.0])


def test_unbounded_components_are_welcome() -> None:
    infinite = (np.full(2, -np.inf), np.full(2, np.inf))
    found = bounded_step(np.eye(2), np.zeros(2), infinite, (np.array([0.0, 1.0]), 3.0))
    np.testing.assert_allclose(found.step, [0.0, 3.0])


def test_a_matrix_whose_square_vanishes_moves_nothing() -> None:
    """A model that hardly changes at all, as a decay that is over long before the data."""
    step = bounded_step(1e-180 * np.eye(2), np.ones(2), (-np.ones(2), np.ones(2)), None)
    assert step.step == pytest.approx(np.zeros(2))
