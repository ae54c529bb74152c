"""What a calibration works on: residuals and their Jacobian as functions of theta."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from identknee.calibrate.scales import floors
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared


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


@declared
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


@declared
class Bounded:
    """A problem whose parameters have bounds of their own.

    Attributes
    ----------
    problem
        The problem.
    parameters
        Its parameters with the bounds wanted.
    """

    problem: Problem
    parameters: Parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, shape ``(m,)``."""
        return self.problem.residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return self.problem.jacobian(theta)


@declared
class Scaled:
    """A problem whose residuals are divided by the standard deviation of their noise."""

    problem: Problem
    sd: Array = array("Standard deviation of every residual", "residual")

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals in units of their noise, shape ``(m,)``."""
        return np.asarray(self.problem.residuals(theta) / self.sd)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return np.asarray(self.problem.jacobian(theta) / self.sd[:, None])


@declared
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
        is_log = parameters.is_log
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


def with_bounds(problem: Problem, bounds: Mapping[str, tuple[float, float]]) -> Problem:
    """The same problem with other bounds for the parameters named.

    Raises
    ------
    ValueError
        If a name is no parameter's, or a lower bound is not below its upper bound or allows
        negative values of a parameter that cannot have them.
    """
    parameters = problem.parameters.with_bounds(bounds)
    for name, low, floor in zip(
        parameters.names, parameters.lower, floors(parameters), strict=True
    ):
        if low < floor:
            raise ValueError(f"the lower bound of {name} must be {floor:g} or more, got {low:g}")
    return Bounded(problem=problem, parameters=parameters)
