"""A problem without its nuisances: their priors averaged over to first order at the best fit."""

from dataclasses import dataclass, field

import numpy as np

from identknee.calibrate.problem import Problem, restricted, without_priors
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Marginal:
    """A problem in which errors change residuals along straight lines and are averaged over.

    Attributes
    ----------
    problem
        Residuals in units of their noise where the errors are as they fit best.
    slopes
        Change of each residual with one prior standard deviation of each error, shape ``(m, e)``.
    offset
        Middle of the priors less the best fit, in prior standard deviations, shape ``(e,)``.
    """

    problem: Problem
    slopes: Array
    offset: Array
    _whitening: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        covariance = np.eye(len(self.slopes)) + self.slopes @ self.slopes.T
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        object.__setattr__(self, "_whitening", whitening)

    @property
    def parameters(self) -> Parameters:
        """The parameters of interest."""
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals, errors at the middle of their priors, in units of noise and errors, (m,)."""
        residuals = self.problem.residuals(theta)
        if not np.isfinite(residuals).all():
            return residuals
        return np.asarray(self._whitening @ (residuals + self.slopes @ self.offset))

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the same, shape ``(m, n)``."""
        return np.asarray(self._whitening @ self.problem.jacobian(theta))


def marginal(problem: Problem, theta: Array) -> Marginal:
    """The problem of the parameters of interest alone.

    Parameters
    ----------
    problem
        In units of noise, with nuisances.
    theta
        Its best fit, shape ``(n,)``.
    """
    parameters = problem.parameters
    is_error, data = ~parameters.is_of_interest, without_priors(problem)
    held = np.array(parameters.names)[is_error].tolist()
    sd = parameters.prior_sd[is_error]
    return Marginal(
        problem=restricted(data, held, theta),
        slopes=data.jacobian(theta)[:, is_error] * sd,
        offset=(parameters.center - theta)[is_error] / sd,
    )
