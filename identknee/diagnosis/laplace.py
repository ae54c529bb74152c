"""The posterior of a fit as a Gaussian within its bounds: evidence and intervals."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_ndtr, logsumexp, ndtri, ndtri_exp
from scipy.stats import qmc

from identknee.identify.evaluation import Evaluation
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen

# Bounds that cut off less of a parameter's posterior than this are none.
LEAST_CUT = 1e-6
# Points at which the share of a Gaussian within bounds is averaged, and the seed of their order.
N_POINTS, POINTS_SEED = 1024, 0
# What a 95 % interval leaves out to either side; all of it on one side where a bound is the other.
TAIL = 0.025


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Laplace:
    """The posterior near a fit: Gaussian in the coordinates in which the priors are.

    These are the logarithms of parameters with lognormal priors and the others as they are.

    Attributes
    ----------
    theta
        The fit, shape ``(p,)``.
    sd
        Posterior standard deviation of each parameter in its own unit, shape ``(p,)``.
    lower, upper
        Ends of their 95 % intervals, within the bounds, shape ``(p,)``.
    log_evidence
        Logarithm of the integral of likelihood times prior within the bounds.
    """

    theta: Array
    sd: Array
    lower: Array
    upper: Array
    log_evidence: float

    def __post_init__(self) -> None:
        for name in ("theta", "sd", "lower", "upper"):
            object.__setattr__(self, name, frozen(getattr(self, name), None, name=name))


def laplace(at: Evaluation, parameters: Parameters, noise_factor: Array) -> Laplace:
    """The posterior around a fit, priors normal or lognormal and cut off at the bounds.

    Exact for a model that is linear in these coordinates, also where a bound holds the fit.

    Parameters
    ----------
    at
        Whitened residuals of the m data, those of the priors after them, and their derivatives.
    parameters
        With bounds and priors.
    noise_factor
        Cholesky factor of the covariance of the data, shape ``(m, m)``.

    References
    ----------
    R. E. Kass and A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995) 773-795,
    doi:10.1080/01621459.1995.10476572, equation 5.
    """
    is_log = np.array(parameters.is_log)
    scale = np.where(is_log, at.theta, 1.0)
    point, center, lower, upper = (
        _logs(x, is_log) for x in (at.theta, parameters.center, parameters.lower, parameters.upper)
    )
    jacobian = at.jacobian * scale
    information = cho_factor(jacobian.T @ jacobian, lower=True)
    covariance = cho_solve(information, np.eye(point.size))
    gradient = jacobian.T @ at.residuals
    middle = point - covariance @ gradient
    prior_mass = log_interval_mass(
        (lower - center) / parameters.prior_sd, (upper - center) / parameters.prior_sd
    )
    m = len(noise_factor)
    log_evidence = (
        -0.5 * (at.deviance - gradient @ covariance @ gradient + m * np.log(2.0 * np.pi))
        - np.log(np.diag(noise_factor)).sum()
        - np.log(parameters.prior_sd).sum()
        - prior_mass.sum()
        - np.log(np.diag(information[0])).sum()
        + log_box_probability(middle, covariance, lower, upper)
    )
    sd = np.sqrt(np.diag(covariance))
    ends = _interval(middle, sd, lower, upper)
    low, high = (np.where(is_log, np.exp(np.where(is_log, x, 0.0)), x) for x in ends)
    return Laplace(
        theta=at.theta,
        sd=scale * sd,
        lower=np.minimum(low, at.theta),
        upper=np.maximum(high, at.theta),
        log_evidence=float(log_evidence),
    )


def _interval(mean: Array, sd: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Ends of 95 % intervals of normal variables within bounds.

    A bound that cuts off a tail of more than 2.5 % is the end of the interval.
    """
    low, high = (lower - mean) / sd, (upper - mean) / sd
    from_low, to_high = low > ndtri(TAIL), high < ndtri(1.0 - TAIL)
    start = _within(low, high, np.where(to_high, 2.0, 1.0) * TAIL)
    end = _within(low, high, 1.0 - np.where(from_low, 2.0, 1.0) * TAIL)
    return (
        np.where(from_low, lower, mean + sd * start),
        np.where(to_high, upper, mean + sd * end),
    )


def log_box_probability(mean: Array, covariance: Array, lower: Array, upper: Array) -> float:
    """Log probability that a Gaussian vector lies between `lower` and `upper`.

    Averaged over points of a Sobol sequence; exact where one component is cut off at most.

    Parameters
    ----------
    mean, covariance
        Of the vector, shapes ``(p,)`` and ``(p, p)``.
    lower, upper
        Bounds, perhaps infinite, shape ``(p,)``.

    References
    ----------
    A. Genz, Numerical computation of multivariate normal probabilities, J. Comput. Graph. Stat. 1
    (1992) 141-149, doi:10.1080/10618600.1992.10477010.
    """
    sd = np.sqrt(np.diag(covariance))
    inside = log_interval_mass((lower - mean) / sd, (upper - mean) / sd)
    # The components cut off most come first: what follows then varies least.
    cut = np.argsort(inside)[: np.count_nonzero(inside < -LEAST_CUT)]
    if cut.size <= 1:
        return float(inside[cut].sum())
    factor = np.linalg.cholesky(covariance[np.ix_(cut, cut)])
    points = qmc.Sobol(cut.size, seed=POINTS_SEED).random(N_POINTS)
    drawn, weights = np.zeros((N_POINTS, cut.size)), np.zeros(N_POINTS)
    for i in range(cut.size):
        known = mean[cut[i]] + drawn[:, :i] @ factor[i, :i]
        low, high = ((x[cut[i]] - known) / factor[i, i] for x in (lower, upper))
        weights += log_interval_mass(low, high)
        drawn[:, i] = _within(low, high, points[:, i])
    return float(logsumexp(weights) - np.log(N_POINTS))


def log_interval_mass(low: Array, high: Array) -> Array:
    """Log probability that a standard normal variable lies between `low` and `high`."""
    # Mirrored to the lower tail, where small probabilities keep their digits.
    mirrored = low > -high
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    top = log_ndtr(high)
    return np.asarray(top + np.log1p(-np.exp(log_ndtr(low) - top)))


def _within(low: Array, high: Array, share: Array) -> Array:
    """Where a `share` of a standard normal variable between two ends lies to the left."""
    mirrored = low > -high
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    share = np.where(mirrored, 1.0 - share, share)
    top = log_ndtr(high)
    found = ndtri_exp(top + np.log(share + (1.0 - share) * np.exp(log_ndtr(low) - top)))
    return np.asarray(np.where(mirrored, -found, found))


def _logs(values: Array, is_log: Array) -> Array:
    """The logarithms where the prior is lognormal."""
    with np.errstate(divide="ignore"):
        return np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
