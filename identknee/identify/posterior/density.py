"""The posterior density of the parameters, in their own units and in those it is sampled in."""

from dataclasses import replace

import numpy as np
from scipy.special import ndtr, ndtri
from typing_extensions import override

from identknee.calibrate.problem import (
    BoundedProblem,
    Evaluation,
    Problem,
    evaluate,
    without_priors,
)
from identknee.identify.binomial_interval import share
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry

# Standard deviation, in distances of the bounds, of a normal prior that is uniform to 0.1 %.
FLAT = 10.0


@declared
class LogPosterior:
    """Natural logarithm of the posterior density of a problem's parameters.

    It is the log likelihood (minus half the deviance, without the constant that depends on the
    noise alone) plus the log prior density: lognormal or normal for each parameter, cut off at the
    bounds and scaled so that its integral within them is 1. The likelihood is 0 where the model
    has no prediction.

    Attributes
    ----------
    problem
        Its residuals in units of their noise; rows of priors are left out, since the density has
        those of all parameters.
    """

    problem: Problem

    def __post_init__(self) -> None:
        object.__setattr__(self, "problem", without_priors(self.problem))
        parameters = self.problem.parameters
        is_log = parameters.is_log
        if np.any(parameters.prior_sd <= 0) or np.any(parameters.center[is_log] <= 0):
            raise ValueError(
                "a prior needs a standard deviation above 0, and a lognormal one a centre above 0; "
                f"got {parameters.prior_sd.tolist()} around {parameters.center.tolist()}"
            )
        if mass_within_bounds(parameters) == 0:
            raise ValueError(
                "the prior has no mass within the bounds; widen the bounds or move the prior"
            )

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def __call__(self, theta: Array) -> float:
        """Log density at `theta`, shape ``(n,)``; -inf beyond the bounds or without prediction."""
        prior = float(log_prior(theta, self.parameters))
        if not np.isfinite(prior):
            return -np.inf
        return prior - 0.5 * evaluate(self.problem, theta).deviance


def with_uniform_priors(problem: Problem) -> Problem:
    """The problem with all values of a parameter of interest within its bounds as likely.

    Such a prior is a normal one of ten times their distance, which falls by 0.1 % to the bounds.
    Nuisances keep theirs.
    """
    p = problem.parameters
    asked = p.is_of_interest
    parameters = replace(
        p,
        center=np.where(asked, 0.5 * (p.lower + p.upper), p.center),
        prior_sd=np.where(asked, FLAT * (p.upper - p.lower), p.prior_sd),
        is_log=p.is_log & ~asked,
        own=p.start,
    )
    return BoundedProblem(problem=without_priors(problem), parameters=parameters)


def log_prior(theta: Array, parameters: Parameters) -> Array:
    """Log prior density of thetas, shape ``(..., n)``; -inf beyond the bounds.

    Its integral within the bounds is 1.
    """
    theta = np.asarray(theta, dtype=np.float64)
    is_inside = inside(theta, parameters)
    working = parameters.to_working(np.where(is_inside[..., None], theta, parameters.center))
    log_density = (
        log_prior_working(working, parameters)
        - np.sum(working[..., parameters.is_log], axis=-1)
        - np.sum(_log_masses(parameters))
    )
    return np.where(is_inside, log_density, -np.inf)


def mass_within_bounds(parameters: Parameters) -> float:
    """Prior mass within the bounds, before truncation."""
    return float(np.exp(np.sum(_log_masses(parameters))))


def inside(theta: Array, parameters: Parameters) -> BoolArray:
    """Whether thetas, shape ``(..., n)``, are within the bounds and lognormal ones above 0."""
    within = (theta >= parameters.lower) & (theta <= parameters.upper)
    return np.asarray(np.all(within & ((theta > 0) | ~parameters.is_log), axis=-1))


def log_prior_working(working: Array, parameters: Parameters) -> Array:
    """Log prior density of working coordinates, shape ``(..., n)``, without regard to bounds."""
    sd = parameters.prior_sd
    z = (working - working_center(parameters)) / sd
    return np.asarray(np.sum(-0.5 * z**2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi), axis=-1))


def working_center(parameters: Parameters) -> Array:
    """Centre of the normal priors in working coordinates, shape ``(n,)``."""
    return parameters.to_working(parameters.center)


def prior_quantiles(parameters: Parameters, probabilities: Array) -> Array:
    """Theta at so much of each prior within its bounds, shape ``(..., n)`` as `probabilities`."""
    low, high = _working_bounds(parameters)
    center, sd = working_center(parameters), parameters.prior_sd
    first, last = ndtr((low - center) / sd), ndtr((high - center) / sd)
    theta = parameters.from_working(center + sd * ndtri(first + probabilities * (last - first)))
    return np.asarray(np.clip(theta, parameters.lower, parameters.upper))


def prior_draws(parameters: Parameters, n: int, generator: np.random.Generator) -> Array:
    """Draws of theta from the priors within the bounds, shape ``(n, p)``."""
    return prior_quantiles(parameters, generator.uniform(size=(n, parameters.n)))


@declared
class InfeasiblePriorMass:
    """Prior mass without a prediction or beyond the bounds."""

    beyond_bounds: float = entry("Part of the priors that the bounds cut off, exact", unit="1")
    without_prediction: float = entry(
        "Part of the prior within the bounds where the model has no prediction, estimated; null "
        "without draws",
        unit="1",
    )
    low: float = entry("Lower 95 % confidence limit of that estimate", unit="1")
    high: float = entry("Upper 95 % confidence limit of that estimate", unit="1")
    n_draws: int = entry("Draws of the prior simulated for it", unit="1")

    @override
    def __str__(self) -> str:
        """Both parts as a sentence."""
        return (
            f"The bounds exclude {100 * self.beyond_bounds:.2g} % of the prior. Another "
            f"{100 * self.without_prediction:.2g} % of what is left has no prediction "
            f"(95 % confidence interval {100 * self.low:.2g} to {100 * self.high:.2g} %, from "
            f"{self.n_draws} draws)."
        )


def infeasible_prior_mass(parameters: Parameters, is_predicted: BoolArray) -> InfeasiblePriorMass:
    """The excluded prior mass; `is_predicted` is that of draws of the prior, shape ``(n,)``."""
    failed = share(int(np.sum(~is_predicted)), len(is_predicted))
    return InfeasiblePriorMass(
        beyond_bounds=max(0.0, 1.0 - mass_within_bounds(parameters)),
        without_prediction=failed.value,
        low=failed.lower,
        high=failed.upper,
        n_draws=failed.n,
    )


@declared
class NewtonKernel:
    """The density at a point, and the Gaussian proposal of its Gauss-Newton step."""

    log_density: float = entry(
        "Log density of the posterior in working coordinates, without a constant; -inf where "
        "there is none"
    )
    center: Array = array("End of the Gauss-Newton step", "parameter")
    factor: Array = array(
        "Lower Cholesky factor of the precision there", "parameter", "other parameter"
    )


def newton_kernel(evaluation: Evaluation, parameters: Parameters) -> NewtonKernel:
    """The kernel of a point from its simulation; one with zeros if it has no prediction.

    The precision is that of the linearised residuals and the priors, so that the kernel is the
    posterior itself where the residuals are linear in the working coordinates.
    """
    n = parameters.n
    if not evaluation.is_finite:
        return NewtonKernel(log_density=-np.inf, center=np.zeros(n), factor=np.zeros((n, n)))
    working = parameters.to_working(evaluation.theta)
    slope = np.where(parameters.is_log, evaluation.theta, 1.0)
    jacobian = evaluation.jacobian * slope
    precision = 1.0 / parameters.prior_sd**2
    gradient = jacobian.T @ evaluation.residuals + precision * (
        working - working_center(parameters)
    )
    information = jacobian.T @ jacobian + np.diag(precision)
    factor = np.asarray(np.linalg.cholesky(information), dtype=np.float64)
    log_density = -0.5 * evaluation.deviance + float(log_prior_working(working, parameters))
    center = working - np.linalg.solve(information, gradient)
    return NewtonKernel(log_density=log_density, center=center, factor=factor)


def _working_bounds(parameters: Parameters) -> tuple[Array, Array]:
    is_log = parameters.is_log
    bounds = (parameters.lower, parameters.upper)
    with np.errstate(divide="ignore"):
        low, high = (np.where(is_log, np.log(np.maximum(x, 0.0)), x) for x in bounds)
    return low, high


def _log_masses(parameters: Parameters) -> Array:
    """Log mass of each prior within its bounds, shape ``(n,)``."""
    low, high = _working_bounds(parameters)
    center, sd = working_center(parameters), parameters.prior_sd
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(ndtr((high - center) / sd) - ndtr((low - center) / sd)))
