"""What a calibration works on: residuals and their Jacobian as functions of theta."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array


class Problem(Protocol):
    """Anything with residuals to be made small: a laxity model with data, or a user's own model."""

    @property
    def parameters(self) -> Parameters:
        """The free parameters, in the order of theta."""
        ...

    def residuals(self, theta: Array) -> Array:
        """Residuals at `theta`, shape ``(m,)``; all infinite where the model has no prediction."""
        ...

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals, shape ``(m, n)``; asked only where residuals are finite."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Restricted:
    """A problem in which only some parameters move.

    Attributes
    ----------
    problem
        The problem in all parameters.
    free
        Its parameters that move, and the values of the others.
    """

    problem: Problem
    free: FreeParameters

    @property
    def parameters(self) -> Parameters:
        """Those that move."""
        return self.free.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, shape ``(m,)``."""
        return self.problem.residuals(self.free.expand(theta))

    def jacobian(self, theta: Array) -> Array:
        """Derivatives by the parameters that move, shape ``(m, n_free)``."""
        return self.free.restrict(self.problem.jacobian(self.free.expand(theta)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WithPriors:
    """A problem with one more residual for each parameter: its distance from the prior's centre.

    The residual is ``(theta - center) / sd`` for a normal prior and
    ``(ln theta - ln center) / sd`` for a lognormal one, so that least squares gives the point of
    highest posterior density (in theta for normal, in its logarithm for lognormal priors) where
    the other residuals are in units of their noise.
    """

    problem: Problem

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, then those of the priors, shape ``(m + n,)``.

        All are infinite where a parameter with a lognormal prior is not positive.
        """
        parameters = self.parameters
        is_log = np.array(parameters.is_log)
        data = self.problem.residuals(theta)
        if np.any(theta[is_log] <= 0):
            return np.full(data.size + parameters.n, np.inf)
        rows = theta - parameters.center
        rows[is_log] = np.log(theta[is_log] / parameters.center[is_log])
        return np.concatenate([data, rows / parameters.prior_sd])

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the same, shape ``(m + n, n)``."""
        parameters = self.parameters
        slope = np.where(parameters.is_log, 1.0 / np.where(parameters.is_log, theta, 1.0), 1.0)
        return np.vstack([self.problem.jacobian(theta), np.diag(slope / parameters.prior_sd)])


def restricted(problem: Problem, fixed: Sequence[str], values: Array) -> Restricted:
    """The problem with the parameters named `fixed` held at their `values`, shape ``(n,)``.

    Raises
    ------
    ValueError
        If a name is not a parameter's or none is left free.
    """
    free = problem.parameters.with_fixed(fixed, values)
    if not free.free_indices:
        raise ValueError("all parameters are fixed; leave at least one free")
    return Restricted(problem=problem, free=free)
