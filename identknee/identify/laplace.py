"""The posterior near a fit as a Gaussian cut off at the bounds: intervals and evidence."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from identknee.calibrate.evaluation import Evaluation
from identknee.identify.normal_in_box import (
    box_intervals,
    log_box_probability,
    log_interval_mass,
)
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, frozen

# Share of a standard deviation that rounding may move an end by.
ROUNDING = 1e-9

Interval = tuple[float | None, float | None]


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
    is_lower_open, is_upper_open
        Whether an end is no limit that the data give, shape ``(p,)``: a bound, or the estimate
        itself where the straight model puts the interval beside it.
    log_evidence
        Logarithm of the integral of likelihood times prior within the bounds.
    """

    theta: Array
    sd: Array
    lower: Array
    upper: Array
    is_lower_open: BoolArray
    is_upper_open: BoolArray
    log_evidence: float

    def __post_init__(self) -> None:
        for name in ("theta", "sd", "lower", "upper"):
            object.__setattr__(self, name, frozen(getattr(self, name), None, name=name))

    def interval(self, i: int) -> tuple[float | None, float | None]:
        """Ends of the interval of one parameter; None where the data give none."""
        return (
            None if self.is_lower_open[i] else float(self.lower[i]),
            None if self.is_upper_open[i] else float(self.upper[i]),
        )


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
    found = box_intervals(middle, covariance, lower, upper)
    # A fit stopped before its minimum is not where the straight model puts the parameters, and
    # neither end of such an interval is known.
    slack = ROUNDING * sd
    is_beside = (found.lower > point + slack) | (found.upper < point - slack)
    low, high = (
        np.where(is_log, np.exp(np.where(is_log, x, 0.0)), x) for x in (found.lower, found.upper)
    )
    return Laplace(
        theta=at.theta,
        sd=scale * sd,
        lower=np.minimum(low, at.theta),
        upper=np.maximum(high, at.theta),
        is_lower_open=found.is_lower_bound | is_beside,
        is_upper_open=found.is_upper_bound | is_beside,
        log_evidence=float(log_evidence),
    )


def _logs(values: Array, is_log: BoolArray) -> Array:
    """The logarithms where the prior is lognormal."""
    with np.errstate(divide="ignore"):
        return np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
