"""Indices from correlated draws against closed forms."""

import warnings
from itertools import permutations

import numpy as np
import pytest
from SALib.analyze import pawn as salib_pawn

from identknee.identify.sensitivity_estimators import (
    METHODS,
    converging_indices,
    delta_index,
    leading_component,
    pawn_index,
    shapley_index,
)
from identknee.runs.declare import Array

HALF_WIDTHS = 3.0
LEVELS = np.array([400, 800])
CORRELATED = np.array([[1.0, -0.8, 0.0], [-0.8, 1.0, 0.3], [0.0, 0.3, 1.0]])
SLOPES = np.array([1.0, 0.5, -2.0])


def gaussian(n: int, seed: int = 0, covariance: Array = CORRELATED) -> Array:
    return np.random.default_rng(seed).multivariate_normal(np.zeros(len(covariance)), covariance, n)


def linear_gaussian_shapley(slopes: Array, covariance: Array) -> Array:
    """Shapley effects by their definition, over all orders (Owen and Prieur 2017)."""
    p = len(slopes)
    with_output = covariance @ slopes

    def explained(subset: tuple[int, ...]) -> float:
        if not subset:
            return 0.0
        of = list(subset)
        part = with_output[of]
        return float(part @ np.linalg.solve(covariance[np.ix_(of, of)], part))

    effects = np.zeros(p)
    orders = list(permutations(range(p)))
    for order in orders:
        for k, i in enumerate(order):
            effects[i] += explained(order[: k + 1]) - explained(order[:k])
    return effects / len(orders) / float(slopes @ with_output)


def test_shapley_effects_of_a_linear_function_of_gaussians() -> None:
    draws = gaussian(4000)
    found = shapley_index(draws, draws @ SLOPES, 0)["shapley"]
    # With the covariance of the draws themselves the formula holds without sampling error.
    exact = linear_gaussian_shapley(SLOPES, np.cov(draws.T))
    assert found == pytest.approx(exact, abs=2e-3)
    assert found.sum() == pytest.approx(1.0, abs=1e-6)
    within = converging_indices("shapley", draws[:800], draws[:800] @ SLOPES, LEVELS, 1)["shapley"]
    error = np.abs(within["values"][-1] - linear_gaussian_shapley(SLOPES, CORRELATED))
    assert np.all(error < HALF_WIDTHS * within["half_widths"][-1])


def test_shapley_effects_of_two_correlated_inputs_have_the_known_formula() -> None:
    """Iooss and Prieur 2019, section 3.2: what two inputs share goes half to each."""
    rho, b = -0.9, np.array([1.0, 2.0])
    covariance = np.array([[1.0, rho], [rho, 1.0]])
    variance = b @ covariance @ b
    shared = 0.5 * rho**2 * (b[1] ** 2 - b[0] ** 2)
    exact = np.array([b[0] ** 2 + rho * b[0] * b[1] + shared]) / variance
    assert linear_gaussian_shapley(b, covariance)[0] == pytest.approx(exact[0], abs=1e-12)
    draws = gaussian(20000, seed=4, covariance=covariance)
    found = shapley_index(draws, draws @ b, 0)["shapley"]
    assert found[0] == pytest.approx(exact[0], abs=0.01)


def test_shapley_effects_see_interactions() -> None:
    draws = np.random.default_rng(0).normal(size=(3000, 3))
    found = shapley_index(draws, draws[:, 0] * draws[:, 1], 0)["shapley"]
    assert found == pytest.approx([0.5, 0.5, 0.0], abs=0.02)


def test_hdmr_splits_own_and_shared_variance() -> None:
    """For a linear function: own b_i^2 s_i^2, shared what the covariances add."""
    draws = gaussian(1500)
    found = converging_indices("hdmr", draws, draws @ SLOPES, np.array([1500]), 0)
    variance = SLOPES @ CORRELATED @ SLOPES
    own = SLOPES**2 / variance
    both = SLOPES * (CORRELATED @ SLOPES) / variance
    for name, exact in (("Sa", own), ("Sb", both - own), ("ST", both)):
        error = np.abs(found[name]["values"][-1] - exact)
        assert np.all(error <= HALF_WIDTHS * found[name]["half_widths"][-1] + 0.01)


def test_delta_of_a_linear_function_of_gaussians() -> None:
    """One of two equal shares: delta by quadrature of the densities."""
    draws = gaussian(3000, covariance=np.eye(2))
    grid = np.linspace(-8, 8, 2001)
    inputs = np.linspace(-5, 5, 801)

    def density(y: Array, mean: Array, sd: float) -> Array:
        return np.asarray(np.exp(-0.5 * ((y - mean) / sd) ** 2) / sd / np.sqrt(2 * np.pi))

    areas = [
        np.trapezoid(np.abs(density(grid, 0.0 * grid, np.sqrt(2)) - density(grid, x, 1.0)), grid)
        for x in inputs
    ]
    exact = 0.5 * np.trapezoid(np.array(areas) * density(inputs, 0.0 * inputs, 1.0), inputs)
    found = converging_indices("delta", draws, draws.sum(axis=1), np.array([3000]), 0)["delta"]
    # Kernel densities of Gaussians are a little too wide, and stay so with more draws.
    assert found["values"][-1] == pytest.approx([exact, exact], abs=0.04)
    assert found["half_widths"].max() < 0.04
    assert abs(float(found["noise_floor"])) < 0.06


def global_state() -> str:
    return str(np.random.get_state())  # noqa: NPY002 - it must stay as it is


@pytest.mark.parametrize("method", METHODS)
def test_an_input_without_influence_is_told_from_one_that_decides(method: str) -> None:
    draws = gaussian(800, covariance=np.eye(3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        state = global_state()
        found = converging_indices(method, draws, draws[:, 1] ** 3, LEVELS, 0)
        assert global_state() == state
    name = "ST" if method == "hdmr" else method
    values = found[name]["values"][-1]
    assert values[1] > 0.4
    assert max(values[0], values[2]) < 0.25
    assert found[name]["values"].shape == found[name]["half_widths"].shape == (2, 3)
    again = converging_indices(method, draws, draws[:, 1] ** 3, LEVELS, 0)
    assert np.array_equal(again[name]["values"], found[name]["values"])


@pytest.mark.parametrize("method", METHODS)
def test_constant_outputs_and_few_draws(method: str) -> None:
    draws = gaussian(400)
    for scores, expected in (
        (np.full(400, 2.5), 0.0),
        (np.r_[np.full(200, np.nan), draws[200:, 0]], np.nan),
    ):
        found = converging_indices(method, draws, scores, np.array([400]), 0)
        for part in found.values():
            assert np.array_equal(part["values"], np.full((1, 3), expected), equal_nan=True)


def test_pawn_is_that_of_salib() -> None:
    draws = gaussian(500)
    for scores in (draws @ SLOPES, np.round(draws[:, 0])):
        problem = {"num_vars": 3, "names": list("abc"), "bounds": [[-4.0, 4.0]] * 3}
        theirs = salib_pawn.analyze(problem, draws, scores)["median"]
        # It leaves the largest value of a parameter out of its last slice of 50.
        assert pawn_index(draws, scores, 0)["pawn"] == pytest.approx(theirs, abs=0.02)


def test_failures_as_an_output() -> None:
    """A two-valued output: |P(fails given x) - P(fails)| on average."""
    draws = np.random.default_rng(0).random((4000, 2))
    failed = (draws[:, 0] > 0.75).astype(float)
    assert delta_index(draws, failed, 0)["delta"] == pytest.approx([0.375, 0.0], abs=0.03)
    assert pawn_index(draws, failed, 0)["pawn"][0] > 0.2
    assert shapley_index(draws, failed, 0)["shapley"][1] == pytest.approx(0.0, abs=0.01)


def test_the_leading_component_tells_most_of_a_group() -> None:
    x = np.random.default_rng(0).normal(size=500)
    outputs = np.stack([-2.0 * x, -x, 0.01 * x**2], axis=1)
    outputs[7, 1] = np.nan
    scores, share = leading_component(outputs)
    assert np.isnan(scores[7])
    known = np.isfinite(scores)
    assert known.sum() == 499
    # Larger where the outputs are larger on the whole.
    assert np.corrcoef(scores[known], -x[known])[0, 1] > 0.999
    assert share > 0.999
    scores, share = leading_component(np.full((4, 2), np.nan))
    assert np.isnan(scores).all()
    assert share == 1.0
    assert leading_component(np.ones((4, 2)))[1] == 1.0


def test_too_many_parameters_for_shapley_are_refused() -> None:
    with pytest.raises(ValueError, match="15 parameters need"):
        shapley_index(np.zeros((400, 15)), np.zeros(400), 0)
