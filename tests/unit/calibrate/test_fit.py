import pickle
from typing import Any

import numpy as np
import pytest
from problems import IG2, IG4, Cliff, ClosedForm, Linear, linear, plain_parameters, sloppy_springs

from identknee.calibrate.fit import BUDGET, METHODS, fit, fit_many, waterfall
from identknee.model.parameters import Parameters
from identknee.runs.executors import process_pool, threads
from identknee.runs.record import Outcome


def a_linear() -> Linear:
    problem = linear()
    data = -problem.residuals(np.zeros(3))
    return Linear(parameters=problem.parameters, matrix=problem.jacobian(problem.start), data=data)


def test_the_default_budget_is_the_papers() -> None:
    problem = linear()
    assert BUDGET == 2500
    assert fit(problem, problem.start).budget == 2500


def test_fixed_parameters_keep_their_start() -> None:
    problem = sloppy_springs()
    fixed = ("ACL.stiffness_kN", "PCL.stiffness_kN", "LCL.stiffness_kN", "MCL.stiffness_kN")
    end = fit(problem, np.r_[problem.minimum[:4], IG4[4:]], fixed=fixed)
    assert end.outcome is Outcome.MINIMUM
    assert end.fixed == fixed
    assert end.parameters.n == 8
    np.testing.assert_array_equal(end.theta[:4], problem.minimum[:4])
    np.testing.assert_allclose(end.theta[4:], problem.minimum[4:], atol=1e-9)


def test_fixed_at_other_values_is_the_conditional_minimum() -> None:
    problem = linear()
    held = 1.5
    end = fit(problem, [held, 0.0, 0.0], fixed=(problem.parameters.names[0],))
    matrix, data = problem.jacobian(problem.start), -problem.residuals(np.zeros(3))
    expected = np.linalg.lstsq(matrix[:, 1:], data - held * matrix[:, 0], rcond=None)[0]
    # An objective of 0.1 no longer shows steps below 1e-8.
    np.testing.assert_allclose(end.theta, np.r_[held, expected], rtol=1e-8)


@pytest.mark.parametrize("method", ["least-squares", "complex"])
def test_normal_priors_give_the_posterior_mean(method: str) -> None:
    problem = linear()
    end = fit(problem, problem.start, method=method, priors=True)
    matrix, data = problem.jacobian(problem.start), -problem.residuals(np.zeros(3))
    precision = matrix.T @ matrix + np.eye(3) / 2.0**2
    expected = np.array(np.linalg.solve(precision, matrix.T @ data), dtype=np.float64)
    # The Complex method stops at a spread of 1e-3.
    np.testing.assert_allclose(
        end.theta, expected, atol=1e-12 if method == "least-squares" else 1e-3
    )
    own = 0.5 * np.sum(problem.residuals(expected) ** 2) + 0.5 * np.sum((expected / 2.0) ** 2)
    assert end.objective == pytest.approx(own, rel=1e-5)
    assert end.priors


def test_lognormal_prior_gives_the_mode_in_the_logarithm() -> None:
    parameters = Parameters(
        names=("A.stiffness_kN",),
        center=np.array([9.0]),
        lower=np.array([0.0]),
        upper=np.array([40.0]),
        prior_sd=np.array([0.35]),
        is_log=np.array([True]),
    )
    # A measurement of ln theta with sd 0.1 at ln 14: the mode is a weighted mean of logarithms.
    problem = ClosedForm(
        name="logarithm",
        parameters=parameters,
        start=np.array([5.0]),
        minimum=np.array([14.0]),
        lowest=0.0,
        residuals_at=lambda x: (np.log(x) - np.log(14.0)) / 0.1,
        jacobian_at=lambda x: np.diag(1.0 / x) / 0.1,
    )
    end = fit(problem, problem.start, priors=True)
    weights = np.array([1 / 0.1**2, 1 / 0.35**2])
    expected = np.exp(weights @ np.log([14.0, 9.0]) / weights.sum())
    assert end.theta[0] == pytest.approx(expected, rel=1e-9)


def test_a_fit_says_how_it_went() -> None:
    end = fit(sloppy_springs(), IG2)
    assert end.message.startswith("Exact derivatives confirm a local minimum. It took ")
    assert f"{end.n_simulations} simulations" in end.message
    assert end.seconds > 0
    table = str(end)
    assert "ACL.stiffness_kN" in table
    assert "least-squares" in table
    assert not end.theta.flags.writeable
    assert not end.history.flags.writeable


def test_fits_are_picklable() -> None:
    end = fit(linear(), linear().start)
    again = pickle.loads(pickle.dumps(end))
    np.testing.assert_array_equal(again.theta, end.theta)
    assert again.outcome is end.outcome


def test_no_prediction_anywhere_is_said_of_every_method() -> None:
    problem = Cliff(problem=linear(), beyond=lambda _: 1.0)
    end = fit(problem, problem.problem.start, method="complex", budget=60)
    assert end.outcome is Outcome.START_FAILED
    assert "60 simulations around the start" in end.message
    assert end.history.shape == (0, 2)
    assert end.gradient_norm is None


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"method": "simplex"}, "no method 'simplex'; the methods are least-squares, complex"),
        ({"budget": 0}, "at least 1 simulation, got 0"),
        ({"seed": -1}, "must not be negative, got -1"),
        ({"fixed": ("x9",)}, "no parameter 'x9'"),
    ],
)
def test_mistakes_are_named(settings: Any, sentence: str) -> None:
    problem = linear()
    with pytest.raises(ValueError, match=sentence):
        fit(problem, problem.start, **settings)


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        ([1.0, 2.0], "the start must have shape 3"),
        ([1.0, np.nan, 2.0], "start of x1.value_pct must be a finite number, got nan"),
        (["a", 1, 2], "numbers only"),
    ],
)
def test_bad_starts_are_named(start: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        fit(linear(), start)


def test_many_fits_keep_the_order_and_the_failed_ones() -> None:
    problem = linear()
    cliff = Cliff(problem=problem, beyond=lambda x: float(x[0] - 8.0))
    starts = np.array([problem.start, [9.0, 0.0, 0.0], problem.minimum])
    fits = fit_many(cliff, starts)
    assert [end.outcome for end in fits] == [
        Outcome.MINIMUM,
        Outcome.START_FAILED,
        Outcome.MINIMUM,
    ]
    np.testing.assert_array_equal([end.start for end in fits], starts)
    heights = waterfall(fits)
    np.testing.assert_allclose(heights[:2], problem.lowest, rtol=1e-12)
    assert heights[2] == np.inf


def test_each_of_many_fits_can_be_repeated_alone() -> None:
    problem = a_linear()
    starts = np.random.default_rng(0).uniform(-3, 3, (3, 3))
    fits = fit_many(problem, starts, seed=11, method="complex", budget=300)
    assert len({end.seed for end in fits}) == 3
    for end in fits:
        alone = fit(problem, end.start, method="complex", seed=end.seed, budget=300)
        np.testing.assert_array_equal(alone.history, end.history)


@pytest.mark.parametrize("pool", [threads, process_pool])
def test_executors_agree_bit_for_bit(pool: Any) -> None:
    problem = a_linear()
    starts = np.random.default_rng(0).uniform(-3, 3, (3, 3))
    serially = fit_many(problem, starts, seed=4, method="complex", budget=300)
    with pool(2) as executor:
        elsewhere = fit_many(
            problem, starts, seed=4, executor=executor, method="complex", budget=300
        )
    for one, other in zip(serially, elsewhere, strict=True):
        np.testing.assert_array_equal(one.theta, other.theta)
        np.testing.assert_array_equal(one.history, other.history)


def test_no_starts_give_no_fits() -> None:
    fits = fit_many(a_linear(), np.empty((0, 3)))
    assert fits == ()
    assert waterfall(fits).shape == (0,)


def test_other_units_have_a_box_too() -> None:
    parameters = Parameters(
        names=("gain",),
        center=np.array([1.0]),
        lower=np.array([0.5]),
        upper=np.array([2.0]),
        prior_sd=np.array([0.1]),
        is_log=np.array([True]),
    )
    problem = ClosedForm(
        name="gain",
        parameters=parameters,
        start=np.ones(1),
        minimum=np.array([1.1]),
        lowest=0.0,
        residuals_at=lambda x: 10 * (x - 1.1),
        jacobian_at=lambda _: np.full((1, 1), 10.0),
    )
    for method in METHODS:
        end = fit(problem, problem.start, method=method, budget=400)
        assert abs(end.theta[0] - 1.1) < 0.01, method


def test_one_percent_parameters_only_need_names() -> None:
    assert plain_parameters(1).names == ("x0.value_pct",)
