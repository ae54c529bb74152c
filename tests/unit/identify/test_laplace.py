"""Evidence and intervals against closed forms and integrals on a grid."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import log_ndtr, ndtri_exp
from tolerances import CLOSED_FORM

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import Evaluator, ProblemWithPriors
from identknee.identify.laplace import (
    BoxMarginals,
    Laplace,
    laplace,
    log_box_probability,
    log_evidence,
    log_interval_mass,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

SOLVED = 1e4 * CLOSED_FORM
# 1,024 points of a Sobol sequence on smooth integrands; their own error is below.
SAMPLED = 3e-3
SD = 0.5
N_DATA = 12
N_GRID = 501


@dataclass(frozen=True, kw_only=True)
class Line:
    """Residuals of a linear model in units of its noise."""

    columns: Array
    measured: Array
    parameters: Parameters

    def residuals(self, theta: Array) -> Array:
        return np.asarray((self.columns @ theta - self.measured) / SD)

    def jacobian(self, theta: Array) -> Array:
        assert theta.shape == (self.columns.shape[1],)
        return np.asarray(self.columns / SD)

    def likelihood(self, theta: Array) -> float:
        return float(stats.norm(scale=SD).pdf(self.columns @ theta - self.measured).prod())


def line(
    truth: list[float], *, lower: list[float] | None = None, is_log: bool = False, seed: int = 0
) -> Line:
    """Data of `truth` with noise; priors with centres 0 or, lognormal, 1."""
    n = len(truth)
    generator = np.random.default_rng(seed)
    columns = generator.standard_normal((N_DATA, n)) / 3
    return Line(
        columns=columns,
        measured=columns @ np.array(truth) + SD * generator.standard_normal(N_DATA),
        parameters=Parameters(
            names=tuple(f"slope{i}" for i in range(n)),
            center=np.full(n, float(is_log)),
            lower=np.full(n, -np.inf) if lower is None else np.array(lower),
            upper=np.full(n, np.inf),
            prior_sd=np.linspace(1.0, 2.0, n),
            is_log=np.full(n, is_log),
        ),
    )


def posterior(made: Line) -> Laplace:
    n = made.parameters.n
    found = minimise(Evaluator(ProblemWithPriors(problem=made)), np.full(n, 0.5))
    return laplace(found.evaluation, made.parameters, np.full(N_DATA, SD))


def test_without_bounds_it_is_the_evidence_of_a_linear_model() -> None:
    made = line([1.0, -0.5, 0.2])
    spread = made.columns * made.parameters.prior_sd
    covariance = spread @ spread.T + SD**2 * np.eye(N_DATA)
    exact = stats.multivariate_normal(cov=covariance).logpdf(made.measured)
    found = posterior(made)
    assert found.log_evidence == pytest.approx(exact, rel=SOLVED)
    information = made.columns.T @ made.columns / SD**2 + np.diag(made.parameters.prior_sd**-2.0)
    mean = np.linalg.solve(information, made.columns.T @ made.measured / SD**2)
    sd = np.sqrt(np.diag(np.linalg.inv(information)))
    assert found.sd == pytest.approx(sd, rel=SOLVED)
    ends = stats.norm(mean, sd).interval(0.95)
    intervals = np.array([found.interval(i) for i in range(found.theta.size)], dtype=np.float64)
    np.testing.assert_allclose(intervals, np.transpose(ends), rtol=SOLVED)


@pytest.mark.parametrize("size", [0.3, 0.6, 1.0, 3.0])
def test_an_interval_is_of_the_priors_where_they_make_more_of_the_rise(size: float) -> None:
    made = line([1.0, -0.5, 0.2])
    made = replace(made, columns=made.columns * np.array([size, 1.0, 1.0]))
    priors = np.diag(made.parameters.prior_sd**-2.0)
    data = made.columns.T @ made.columns / SD**2
    for parameters, own in (
        (made.parameters, priors),
        (made.parameters.as_nuisances(), 0.0 * priors),
    ):
        # From the best fit to an end with one slope held, along which the others follow.
        ways = np.linalg.inv(data + priors).T
        shares = [(x @ own @ x) / (x @ (data + priors) @ x) for x in ways]
        found = posterior(replace(made, parameters=parameters)).made_by_priors()
        assert found.tolist() == [x > 0.5 for x in shares]
    # The smaller the column, the less the data say.
    assert bool(posterior(made).made_by_priors()[0]) is (size < 0.5)


@pytest.mark.parametrize("truth", [2.0, 0.3, -1.0])
def test_one_bound_is_exact(truth: float) -> None:
    made = line([truth], lower=[0.0])
    prior = stats.halfnorm(scale=1.0)
    exact = integrate.quad(
        lambda x: made.likelihood(np.array([x])) * prior.pdf(x), 0, 8, epsabs=0, limit=200
    )[0]
    found = posterior(made)
    assert found.log_evidence == pytest.approx(np.log(exact), rel=SOLVED)
    low, high = found.interval(0)
    assert low is None or 0 <= low <= found.theta[0]
    assert high is not None
    assert found.theta[0] <= high


@pytest.mark.parametrize("truth", [[2.0, 0.5], [-1.0, 0.5]])
def test_fits_are_ranked_by_the_evidence_that_is_reported(truth: list[float]) -> None:
    made = line(truth, lower=[0.0, -np.inf])
    found = minimise(Evaluator(ProblemWithPriors(problem=made)), np.full(2, 0.5))
    is_active = np.array([truth[0] < 0.0, False])
    assert found.is_held.tolist() == is_active.tolist()
    constant = N_DATA * np.log(SD * np.sqrt(2.0 * np.pi))
    ranked = log_evidence(found.evaluation, made.parameters, found.is_held)
    assert ranked - constant == pytest.approx(posterior(made).log_evidence, rel=SOLVED)


def test_a_fit_stopped_short_is_ranked_as_it_is() -> None:
    made = line([2.0, -0.5])
    problem = Evaluator(ProblemWithPriors(problem=made))
    theta = posterior(made).theta
    at, short = problem(theta), problem(theta + np.array([0.5, 0.0]))
    free = np.zeros(2, bool)
    lost = log_evidence(at, made.parameters, free) - log_evidence(short, made.parameters, free)
    assert lost == pytest.approx(0.5 * (short.deviance - at.deviance), rel=SOLVED)


@pytest.mark.parametrize("truth", [[1.0, 0.2], [-1.0, -1.0], [0.0, 2.0]])
def test_two_bounds_agree_with_a_grid(truth: list[float]) -> None:
    made = line(truth, lower=[0.0, 0.1])
    x, y = np.linspace(0.0, 6.0, N_GRID), np.linspace(0.1, 10.0, N_GRID)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    errors = points @ made.columns.T - made.measured
    likelihood = stats.norm(scale=SD).logpdf(errors).sum(axis=-1)
    wide = stats.norm(scale=2.0)
    prior = stats.halfnorm.logpdf(x)[:, None] + wide.logpdf(y) - wide.logsf(0.1)
    inner = integrate.simpson(np.exp(likelihood + prior), x=y, axis=1)
    exact = integrate.simpson(inner, x=x)
    assert posterior(made).log_evidence == pytest.approx(np.log(exact), abs=SAMPLED)


def test_a_lognormal_prior_is_integrated_in_its_logarithm() -> None:
    made = line([2.0], lower=[0.0], is_log=True)
    # Ten times the data, so that the posterior is nearly normal in the logarithm.
    made = replace(made, columns=10 * made.columns, measured=10 * made.measured)
    prior = stats.lognorm(s=1.0)
    exact = integrate.quad(
        lambda x: made.likelihood(np.array([x])) * prior.pdf(x), 0, 4, points=[1.9, 2.1]
    )[0]
    found = posterior(made)
    # The next order of Laplace's method is the square of the posterior's relative spread.
    assert found.log_evidence == pytest.approx(np.log(exact), abs=5 * (found.sd[0] / 2) ** 2)
    low, high = found.interval(0)
    assert low is not None
    assert high is not None
    ratio = np.sqrt(high / low)
    assert ratio == pytest.approx(np.exp(1.96 * found.sd[0] / found.theta[0]), rel=1e-3)


def test_the_share_within_bounds_agrees_with_closed_forms() -> None:
    correlation = 0.6
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    zeros, high = np.zeros(2), np.full(2, np.inf)
    exact = 0.25 + np.arcsin(correlation) / (2 * np.pi)
    found = log_box_probability(zeros, covariance, zeros, high)
    assert found == pytest.approx(np.log(exact), abs=SAMPLED)
    independent = log_box_probability(
        np.array([-8.0, -6.0, 3.0]), np.eye(3), np.array([0.0, 0.0, -np.inf]), np.full(3, np.inf)
    )
    tails = stats.norm.logsf(8.0) + stats.norm.logsf(6.0)
    assert independent == pytest.approx(tails, rel=1e-9)
    assert log_box_probability(zeros, covariance, -high, high) == 0.0


def test_the_share_within_bounds_agrees_with_a_library() -> None:
    generator = np.random.default_rng(2)
    root = generator.standard_normal((4, 4))
    covariance, mean = root @ root.T, generator.standard_normal(4)
    lower, upper = mean - 1.0, mean + np.array([0.5, np.inf, 3.0, 1.0])
    library = stats.multivariate_normal(mean, covariance, seed=1).cdf(upper, lower_limit=lower)
    found = log_box_probability(mean, covariance, lower, upper)
    assert found == pytest.approx(np.log(library), abs=2 * SAMPLED)


def test_small_shares_keep_their_digits() -> None:
    low = np.array([-np.inf, 30.0, -31.0, -1.0, -np.inf])
    high = np.array([np.inf, 31.0, -30.0, 1.0, -40.0])
    exact = [0.0, stats.norm.logsf(30.0), stats.norm.logcdf(-30.0), np.log(0.6826894921370859)]
    exact.append(stats.norm.logcdf(-40.0))
    assert log_interval_mass(low, high) == pytest.approx(exact, rel=1e-10)


def test_a_bound_is_the_end_of_an_interval() -> None:
    for truth, is_bounded in ((-6.0, True), (0.3, True), (6.0, False)):
        made = line([truth], lower=[0.0])
        made = replace(made, columns=4 * made.columns, measured=4 * made.measured)
        found = posterior(made)
        information = float(np.sum(made.columns**2)) / SD**2 + 1.0
        mean = float(made.columns[:, 0] @ made.measured) / SD**2 / information
        sd = information**-0.5
        exact = stats.truncnorm(-mean / sd, np.inf, loc=mean, scale=sd)
        cut = stats.norm.cdf(-mean / sd) > 0.025
        assert cut == is_bounded
        low, high = (0.0, 0.95) if is_bounded else (0.025, 0.975)
        start, end = found.interval(0)
        # A bound is no limit that the data give.
        assert start == (None if is_bounded else pytest.approx(exact.ppf(low), rel=1e-8))
        assert end == pytest.approx(exact.ppf(high), rel=1e-8)


def test_a_mean_far_beyond_its_bound_leaves_the_tail_next_to_it() -> None:
    far = 60.0
    with np.errstate(all="raise", under="ignore"):
        marginals = BoxMarginals(
            np.array([far]), np.array([[1.0]]), np.array([-np.inf]), np.array([0.0])
        )
        low, high, *_ = marginals.interval(0)
    fifth = far + ndtri_exp(np.log(0.05) + log_ndtr(-far))
    assert low == pytest.approx(fifth, rel=SOLVED)
    assert high == 0.0


@pytest.mark.parametrize("mean", [[-1.0, 0.5], [-3.0, 1.0], [0.5, 0.2], [-6.0, 4.0]])
def test_a_bound_moves_the_intervals_of_the_others(mean: list[float]) -> None:
    # The second component is free and follows the first, which cannot go below 0.
    correlation = 0.9
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    marginals = BoxMarginals(
        np.array(mean), covariance, np.array([0.0, -np.inf]), np.full(2, np.inf)
    )
    of_first, of_second = marginals.interval(0), marginals.interval(1)
    x, y = np.linspace(0.0, 12.0, 6001), np.linspace(-12.0, 16.0, 2801)
    first = stats.truncnorm(-mean[0], np.inf, loc=mean[0]).pdf(x)
    slope, sd = correlation, np.sqrt(1.0 - correlation**2)
    below = stats.norm.cdf((y[:, None] - mean[1] - slope * (x - mean[0])) / sd)
    share = integrate.simpson(below * first, x=x, axis=1)
    exact = np.interp([0.025, 0.975], share, y)
    assert list(of_second[:2]) == pytest.approx(exact, abs=0.02)
    assert not of_second[2]
    assert of_first[2] == (stats.norm.cdf(-mean[0]) > 0.025)


def test_a_fit_stopped_short_has_no_end_at_its_estimate() -> None:
    made = line([2.0, -0.5])
    made = replace(made, columns=4 * made.columns, measured=4 * made.measured)
    problem = Evaluator(ProblemWithPriors(problem=made))
    whole = posterior(made)
    stopped = np.array(whole.theta)
    stopped[0] -= 3.0 * whole.sd[0]
    found = laplace(problem(stopped), made.parameters, np.full(N_DATA, SD))
    # The linear model puts the interval above the estimate, which is then none of its values.
    assert found.interval(0) == (None, None)
    assert all(None not in whole.interval(i) for i in range(2))


def test_a_parameter_held_at_its_bound_leaves_others_their_estimate_inside() -> None:
    # Untouched by the first's bound, the middle of the second would lie far from its estimate.
    made = line([-3.0, 1.0], lower=[0.0, -np.inf], seed=3)
    strong = np.column_stack([made.columns[:, 0], made.columns[:, 0] + 0.3 * made.columns[:, 1]])
    made = replace(made, columns=4 * strong, measured=4 * strong @ [-3.0, 1.0])
    found = posterior(made)
    assert found.theta[0] == 0.0
    low, high = found.interval(1)
    assert low is not None
    assert high is not None
    assert low < found.theta[1] < high
