"""Samples of posteriors that are known, their stop rule, and their resumption."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import (
    Cliff,
    ClosedForm,
    Linear,
    disc_in_the_way,
    linear,
    plain_parameters,
    sloppy_springs,
)
from scipy.integrate import quad
from slow_cases import some_slow

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import restricted
from identknee.identify.posterior.posterior import Posterior, SampleOutcome, StopRule
from identknee.identify.posterior.sample import Ensembles, sample
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.runs.executors import process_pool, threads
from identknee.runs.store import open_work

# Means and sds are to lie within five of their Monte Carlo standard errors.
SIGMAS = 5.0
SPRINGS = sloppy_springs(noise=0.02)
# Residuals in units of a noise of 0.02.
IN_NOISE = replace(
    SPRINGS,
    residuals_at=lambda theta: SPRINGS.residuals(theta) / 0.02,
    jacobian_at=lambda theta: SPRINGS.jacobian(theta) / 0.02,
)


def line(n: int = 3) -> Linear:
    """A picklable linear problem in units of noise."""
    closed = linear(n=n)
    matrix = closed.jacobian(closed.start)
    return Linear(
        parameters=plain_parameters(n, -50.0, 50.0),
        matrix=matrix,
        data=matrix @ closed.start - closed.residuals(closed.start),
    )


def bent(power: int) -> ClosedForm:
    """One parameter measured through its power, ``x**power = 4`` within 0.5, prior sd 2."""
    return ClosedForm(
        name="bent",
        parameters=plain_parameters(1, -6.0, 6.0),
        start=np.array([2.0]),
        minimum=np.array([2.0]),
        lowest=0.0,
        residuals_at=lambda x: (x**power - 4.0) / 0.5,
        jacobian_at=lambda x: (power * x ** (power - 1))[:, None] / 0.5,
    )


def assert_mean_and_sd(found: Posterior, mean: Any, sd: Any) -> None:
    errors = found.last_check.mean_error * np.asarray(sd)
    assert np.all(np.abs(found.mean - mean) < SIGMAS * errors)
    assert np.all(np.abs(found.sd - sd) < SIGMAS * errors)


def test_a_linear_problem_gives_its_normal_posterior_and_passes_the_gate() -> None:
    problem = line()
    found = sample(problem, seed=1)
    precision = problem.matrix.T @ problem.matrix + np.eye(3) / 4.0
    mean = np.linalg.solve(precision, problem.matrix.T @ problem.data)
    assert found.outcome is SampleOutcome.CONVERGED
    assert found.last_check.is_passed
    sd = np.sqrt(np.asarray(np.diag(np.linalg.inv(precision)), dtype=np.float64))
    assert_mean_and_sd(found, mean, sd)
    assert found.samples.shape[:2] == (4, 8)
    assert found.excluded.without_prediction == 0.0


@pytest.mark.parametrize(
    "moves",
    some_slow(["newton", "hamiltonian", "surrogate", "difference", "stretch"], ["stretch"]),
)
def test_every_kind_of_moves_samples_a_bent_posterior(moves: str) -> None:
    problem = bent(3)

    def density(x: float) -> float:
        return float(np.exp(-0.5 * ((x**3 - 4.0) / 0.5) ** 2 - 0.5 * (x / 2.0) ** 2))

    total, first, second = (
        quad(lambda x, k=k: x**k * density(x), -6, 6, points=[1.5, 1.6])[0] for k in range(3)
    )
    mean = first / total
    rule = StopRule(drift=0.05, autocorrelation_times=20.0)
    found = sample(problem, ensembles=Ensembles(n_ensembles=2, moves=moves), rule=rule, seed=2)
    assert found.outcome is SampleOutcome.CONVERGED
    assert_mean_and_sd(found, np.array([mean]), np.sqrt(np.array([second / total - mean**2])))


def test_walkers_go_from_one_basin_to_the_other() -> None:
    """``x**2 = 4``: each basin holds half of the posterior, however many walkers began there."""
    optima = [[2.0], [-2.0], [2.0]]
    rule = StopRule(drift=0.05)
    found = sample(bent(2), optima=optima, rule=rule, seed=3)
    assert found.outcome is SampleOutcome.CONVERGED
    positive = float((found.kept > 0).mean())
    assert abs(positive - 0.5) < SIGMAS * 0.5 * found.last_check.mean_error.max()


@pytest.mark.slow
def test_a_sloppy_problem_gets_60_effective_draws_from_1000_simulations() -> None:
    rule = StopRule(drift=np.inf)
    found = sample(IN_NOISE, rule=rule, seed=4)
    assert found.outcome is SampleOutcome.CONVERGED
    fewest = min(found.last_check.bulk.sum(axis=1).min(), found.last_check.tail.sum(axis=1).min())
    assert 1000 * fewest / found.n_walk_simulations > 60


def test_nothing_is_sampled_beyond_a_cliff_or_the_bounds() -> None:
    inside = disc_in_the_way()
    problem = Cliff(
        problem=replace(inside.problem, parameters=plain_parameters(2, -5.0, 4.2)),
        beyond=inside.beyond,
    )
    found = sample(problem, rule=StopRule(drift=0.1), seed=5)
    assert found.outcome is SampleOutcome.CONVERGED
    assert np.all(found.samples <= 4.2)
    assert np.all(np.sum(found.samples**2, axis=3) >= 4.0)
    low, high = found.excluded.low, found.excluded.high
    assert low < found.excluded.without_prediction < high


def test_fixed_parameters_stay_out_of_it() -> None:
    problem = line()
    part = restricted(problem, ["x1.value_pct"], np.zeros(3))
    found = sample(part, rule=StopRule(drift=0.1), seed=1)
    assert found.parameters.names == ("x0.value_pct", "x2.value_pct")
    assert found.outcome is SampleOutcome.CONVERGED


def test_the_budget_ends_it_and_that_is_said() -> None:
    found = sample(line(), rule=StopRule(budget=1000), seed=1)
    assert found.outcome is SampleOutcome.BUDGET
    assert "budget" in str(found)
    assert "not met" in str(found)


def test_without_any_prediction_there_is_no_sample_and_no_traceback() -> None:
    nowhere = Cliff(problem=linear(), beyond=lambda _: 1.0)
    found = sample(nowhere, seed=1)
    assert found.outcome is SampleOutcome.START_FAILED
    assert found.excluded.without_prediction == 1.0
    assert "no prediction" in str(found)
    with pytest.raises(ValueError, match="no sample"):
        _ = found.last_check


def test_walkers_begin_where_predictions_end_close_to_the_optimum() -> None:
    """Three hundredths of a standard deviation away there is no prediction on either side."""
    whole = linear()
    optimum = fit(whole, whole.parameters.center, priors=True).theta
    near = Cliff(problem=whole, beyond=lambda x: float(np.max(np.abs(x - optimum))) - 0.03)
    found = sample(near, optima=optimum[None], rule=StopRule(budget=300), seed=2)
    assert found.outcome is not SampleOutcome.START_FAILED
    assert np.all(np.abs(found.samples - optimum) <= 0.03)


def test_log_likelihood_is_minus_half_the_deviance() -> None:
    problem = IN_NOISE
    found = sample(problem, rule=StopRule(budget=500), seed=1)
    residuals = problem.residuals(found.samples[1, 3, -1])
    assert found.log_likelihood[1, 3, -1] == pytest.approx(-0.5 * residuals @ residuals, rel=1e-9)


def same(one: Posterior, other: Posterior) -> bool:
    return (
        np.array_equal(one.samples, other.samples)
        and np.array_equal(one.log_likelihood, other.log_likelihood)
        and one.n_simulations == other.n_simulations
        and str(one.last_check) == str(other.last_check)
    )


@dataclass(frozen=True)
class Killed:
    """A problem that ends the run after some simulations."""

    problem: Linear
    left: list[int]

    @property
    def parameters(self) -> Parameters:
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        self.left[0] -= 1
        if self.left[0] < 0:
            raise KeyboardInterrupt
        return self.problem.residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        return self.problem.jacobian(theta)


@pytest.mark.parametrize("moves", some_slow(["newton", "surrogate"], ["newton", "surrogate"]))
def test_killed_and_resumed_it_is_the_same_bit_for_bit(moves: str, tmp_path: Path) -> None:
    problem = line()
    settings: dict[str, Any] = {
        "ensembles": Ensembles(moves=moves),
        "rule": StopRule(budget=4000),
        "seed": 6,
    }
    whole = sample(problem, **settings)
    path = tmp_path / "work.sqlite"
    for allowed in (300, 700, 900):
        with open_work(path, {"seed": 6}) as store, pytest.raises(KeyboardInterrupt):
            sample(Killed(problem, [allowed]), store=store, **settings)
    with open_work(path, {"seed": 6}) as store:
        resumed = sample(problem, store=store, **settings)
    assert same(resumed, whole)


@pytest.mark.slow
def test_executors_agree_bit_for_bit() -> None:
    problem = line()
    serially = sample(problem, rule=StopRule(budget=2000), seed=7)
    with threads(3) as executor:
        assert same(
            sample(problem, rule=StopRule(budget=2000), seed=7, executor=executor), serially
        )
    with process_pool(2) as executor:
        assert same(
            sample(problem, rule=StopRule(budget=2000), seed=7, executor=executor), serially
        )


def test_independent_draws_lie_apart() -> None:
    found = sample(line(), rule=StopRule(drift=0.1), seed=1)
    places = found.independent(100)
    assert places.shape == (100, 3)
    assert len(np.unique(places, axis=0)) == 100
    assert set(places[:, 0]) == {0, 1, 2, 3}
    assert 100 < len(found.independent(10**6)) < 10**6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sample(line(), optima=[[99.0, 0.0, 0.0]]), "optimum 0 lies outside"),
        (lambda: sample(line(), optima=np.empty((0, 3))), "no optima to start from"),
        (lambda: sample(line(), rule=StopRule(budget=0)), "budget must be at least 1"),
        (lambda: Ensembles(n_ensembles=1), "at least 2 ensembles"),
        (lambda: Ensembles(steps=0), "at least 1 step"),
        (lambda: Ensembles(moves="walk"), "no moves 'walk'"),
        (lambda: sample(line(), ensembles=Ensembles(n_walkers=9)), "even number of at least 8"),
    ],
)
def test_wrong_settings_are_refused(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()  # type: ignore[operator]


def test_an_optimum_at_a_bound_is_a_place_to_start_from() -> None:
    low = 20.0
    # Past the bound in working coordinates and back.
    assert np.exp(np.log(low)) < low
    parameters = Parameters(
        names=("x.stiffness_kN",),
        center=np.array([10.0]),
        lower=np.array([low]),
        upper=np.array([30.0]),
        prior_sd=np.array([0.35]),
        is_log=np.array([True]),
    )
    problem = Linear(parameters=parameters, matrix=np.eye(1), data=np.array([15.0]))
    found = sample(problem, rule=StopRule(budget=1), seed=2)
    np.testing.assert_allclose(found.optima, low, rtol=1e-6)
    assert found.outcome is SampleOutcome.BUDGET
