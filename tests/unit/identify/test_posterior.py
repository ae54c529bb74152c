"""The posterior density against formulas and quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from problems import disc_in_the_way, linear, plain_parameters, sloppy_springs
from scipy.integrate import quad
from scipy.stats import lognorm, norm

from identknee.calibrate.problem import evaluate
from identknee.identify.posterior.posterior import (
    LogPosterior,
    infeasible_prior_mass,
    log_prior,
    mass_within_bounds,
    newton_kernel,
    prior_draws,
    prior_quantiles,
)
from identknee.model.parameters import Parameters

SPRINGS = sloppy_springs(noise=0.05)
CLOSED_FORM = 1e-12
# Five standard errors of a mean over n draws.
SIGMAS = 5.0


def mixed() -> Parameters:
    """One lognormal and one normal parameter, cut off by the bounds."""
    return Parameters(
        names=("a.stiffness_kN", "a.reference_strain_pct"),
        center=np.array([10.0, 1.0]),
        lower=np.array([0.0, -1.0]),
        upper=np.array([15.0, 4.0]),
        prior_sd=np.array([0.35, 2.0]),
        is_log=np.array([True, False]),
    )


def with_mixed_parameters() -> LogPosterior:
    problem = replace(
        linear(n=2),
        parameters=mixed(),
        residuals_at=lambda x: np.array([x[0] - 9.0, x[0] * x[1] - 12.0]),
        jacobian_at=lambda x: np.array([[1.0, 0.0], [x[1], x[0]]]),
    )
    return LogPosterior(problem=problem)


def test_the_prior_has_mass_one_within_the_bounds() -> None:
    density = with_mixed_parameters()
    within = [lognorm(0.35, scale=10.0).cdf(15.0), float(np.diff(norm(1, 2).cdf([-1, 4]))[0])]
    assert mass_within_bounds(density.parameters) == pytest.approx(
        within[0] * within[1], rel=CLOSED_FORM
    )
    at = np.array([8.0, 2.0])
    expected = lognorm(0.35, scale=10.0).logpdf(8.0) + norm(1, 2).logpdf(2.0)
    assert log_prior(at, density.parameters) == pytest.approx(
        expected - np.log(within[0] * within[1]), rel=CLOSED_FORM
    )
    mass, _ = quad(
        lambda k: float(np.exp(log_prior(np.array([k, 2.0]), density.parameters))), 0.0, 15.0
    )
    marginal = norm(1, 2).pdf(2.0) / within[1]
    assert mass == pytest.approx(marginal, rel=1e-8)  # quad's own tolerance


def test_the_density_is_prior_times_likelihood_and_zero_elsewhere() -> None:
    density = with_mixed_parameters()
    at = np.array([8.0, 2.0])
    residuals = density.problem.residuals(at)
    expected = float(log_prior(at, density.parameters)) - 0.5 * float(residuals @ residuals)
    assert density(at) == pytest.approx(expected, rel=CLOSED_FORM)
    for outside in ([16.0, 2.0], [8.0, 5.0], [0.0, 2.0]):
        assert density(np.array(outside)) == -np.inf
    assert LogPosterior(problem=disc_in_the_way())(np.array([0.0, 0.0])) == -np.inf


def test_working_coordinates_go_there_and_back() -> None:
    parameters = mixed()
    theta = np.array([[8.0, 2.0], [1e-3, -1.0]])
    np.testing.assert_allclose(
        parameters.from_working(parameters.to_working(theta)), theta, rtol=CLOSED_FORM
    )


def test_draws_of_the_prior_follow_it() -> None:
    parameters = mixed()
    draws = prior_draws(parameters, 20_000, np.random.default_rng(0))
    assert np.all((draws >= parameters.lower) & (draws <= parameters.upper))
    cut = norm(1, 2).cdf(draws[:, 1])
    uniform = (cut - norm(1, 2).cdf(-1)) / np.diff(norm(1, 2).cdf([-1, 4]))
    assert abs(uniform.mean() - 0.5) < SIGMAS / np.sqrt(12 * len(draws))
    ends = prior_quantiles(parameters, np.array([[0.0, 0.0], [1.0, 1.0]]))
    np.testing.assert_allclose(ends, [parameters.lower, parameters.upper], rtol=CLOSED_FORM)


def test_the_kernel_of_a_linear_problem_is_its_posterior() -> None:
    problem = linear(n=3)
    matrix = problem.jacobian(problem.start)
    precision = matrix.T @ matrix + np.eye(3) / 4.0
    data = matrix @ problem.start - problem.residuals(problem.start)
    mean = np.linalg.solve(precision, matrix.T @ data)
    kernel = newton_kernel(evaluate(problem, problem.start), problem.parameters)
    np.testing.assert_allclose(kernel.center, mean, rtol=1e-10)
    np.testing.assert_allclose(kernel.factor @ kernel.factor.T, precision, rtol=1e-10)


def test_the_kernel_counts_lognormal_priors_in_the_logarithm() -> None:
    """The density of the logarithm lacks the term -log theta that the density of theta has."""
    density = LogPosterior(problem=SPRINGS)
    parameters = density.parameters
    one, other = SPRINGS.minimum, SPRINGS.minimum * 1.1
    kernels = [newton_kernel(evaluate(SPRINGS, x), parameters) for x in (one, other)]
    difference = kernels[1].log_density - kernels[0].log_density
    is_log = np.array(parameters.is_log)
    jacobian = np.sum(np.log(other[is_log])) - np.sum(np.log(one[is_log]))
    assert difference == pytest.approx(density(other) - density(one) + jacobian, rel=1e-10)


def test_a_kernel_without_prediction_has_no_density() -> None:
    problem = disc_in_the_way()
    kernel = newton_kernel(evaluate(problem, np.zeros(2)), problem.parameters)
    assert kernel.log_density == -np.inf


def test_excluded_mass_has_confidence_limits() -> None:
    parameters = plain_parameters(2)
    some = infeasible_prior_mass(parameters, np.array([True] * 90 + [False] * 10))
    assert some.without_prediction == pytest.approx(0.1)
    # Clopper and Pearson, 10 of 100.
    assert (some.low, some.high) == pytest.approx((0.04900469, 0.1762226), rel=1e-6)
    none = infeasible_prior_mass(parameters, np.ones(100, bool))
    assert (none.without_prediction, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(1 - 0.025 ** (1 / 100), rel=1e-9)
    assert f"{100 * some.without_prediction:.3g}" in str(some)


def test_impossible_priors_are_refused() -> None:
    problem = linear(n=2)
    flat = replace(problem, parameters=replace(problem.parameters, prior_sd=np.zeros(2)))
    with pytest.raises(ValueError, match=r"deviation.* 0"):
        LogPosterior(problem=flat)
    far = replace(plain_parameters(2), center=np.array([1e6, 0.0]))
    with pytest.raises(ValueError, match=r"mass.*bounds"):
        LogPosterior(problem=replace(problem, parameters=far))
