"""What a calibration works on: residuals and their Jacobian as functions of theta."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared

STIFFNESS_UNIT = "_kN"
STRAIN_UNIT = "_pct"
ROUNDING = 1e-13
# A typical step that changes the residuals by less than this changes nothing: the squares of one
# over it would overflow.
UNSEEN = 1e-100


def half_widths(parameters: Parameters) -> Array:
    """Half-widths of the box of first candidates around a start, shape ``(n,)``.

    They are 2 kN and 3 % as in the paper (section 2.5), and two prior standard deviations for
    parameters in other units.
    """
    return values_by_unit(parameters, 2.0, 3.0, 2.0 * parameters.prior_sd_in_own_units)


def typical_steps(parameters: Parameters) -> Array:
    """A typical uncertainty of each parameter, shape ``(n,)``: 3 kN, 2 % or the prior's sd."""
    return values_by_unit(parameters, 3.0, 2.0, parameters.prior_sd_in_own_units)


def conditional_sds(jacobian: Array, parameters: Parameters) -> Array:
    """Standard deviation of each parameter where all others are known, shape ``(n,)``.

    Its typical step where that says nothing: where the residuals do not change with it.
    """
    typical = typical_steps(parameters)
    size = np.linalg.norm(jacobian, axis=0)
    changes = size * typical
    known = changes > max(ROUNDING * np.max(changes, initial=0.0), UNSEEN)
    return np.where(known, 1.0 / np.where(known, size, 1.0), typical)


def floors(parameters: Parameters) -> Array:
    """The least admissible value of each parameter, shape ``(n,)``.

    Zero for stiffnesses and for whatever has a lognormal prior, minus infinity for the rest.
    """
    positive = [
        is_log or name.endswith(STIFFNESS_UNIT)
        for name, is_log in zip(parameters.names, parameters.is_log, strict=True)
    ]
    return np.where(positive, 0.0, -np.inf)


def values_by_unit(
    parameters: Parameters, stiffness: ArrayLike, strain: ArrayLike, others: Array
) -> Array:
    """Values for stiffnesses in kN, strains in % and all others, shape ``(n,)`` each or numbers."""
    is_stiffness, is_strain = (
        np.array([name.endswith(unit) for name in parameters.names])
        for unit in (STIFFNESS_UNIT, STRAIN_UNIT)
    )
    return np.where(is_stiffness, stiffness, np.where(is_strain, strain, others))


class Problem(Protocol):
    """A least-squares problem: a laxity model with data, or a user's own model."""

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
class RestrictedProblem:
    """A problem in which only some parameters are free.

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
        """The free parameters."""
        return self.free.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, shape ``(m,)``."""
        return self.problem.residuals(self.free.expand(theta))

    def jacobian(self, theta: Array) -> Array:
        """Derivatives by the free parameters, shape ``(m, n_free)``."""
        return self.free.restrict(self.problem.jacobian(self.free.expand(theta)))


@declared
class BoundedProblem:
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
class WhitenedResiduals:
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
class ProblemWithPriors:
    """A problem with one more residual for each prior: a parameter's distance from its centre.

    The residual is ``(theta - center) / sd`` for a normal prior and
    ``(ln theta - ln center) / sd`` for a lognormal one, so that least squares gives the point of
    highest posterior density (in theta for normal, in its logarithm for lognormal priors) where
    the other residuals are in units of their noise.

    Attributes
    ----------
    problem
        The problem.
    has_prior
        Which parameters have such a residual, k of them, shape ``(n,)``; all where None.
    """

    problem: Problem
    has_prior: BoolArray | None = None

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    @property
    def _places(self) -> IntArray:
        if self.has_prior is None:
            return np.arange(self.parameters.n)
        return np.flatnonzero(self.has_prior)

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, then those of the priors, shape ``(m + k,)``.

        All are infinite where a parameter with a lognormal prior is not positive.
        """
        parameters, places = self.parameters, self._places
        is_log = parameters.is_log[places]
        data, values, center = self.problem.residuals(theta), theta[places], parameters.center
        if np.any(values[is_log] <= 0):
            return np.full(data.size + places.size, np.inf)
        rows = values - center[places]
        rows[is_log] = np.log(values[is_log] / center[places][is_log])
        return np.concatenate([data, rows / parameters.prior_sd[places]])

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the same, shape ``(m + k, n)``."""
        parameters, places = self.parameters, self._places
        is_log, values = parameters.is_log[places], theta[places]
        slope = np.where(is_log, 1.0 / np.where(is_log, values, 1.0), 1.0)
        priors = np.zeros((places.size, parameters.n))
        priors[np.arange(places.size), places] = slope / parameters.prior_sd[places]
        return np.vstack([self.problem.jacobian(theta), priors])


def with_nuisance_priors(problem: Problem) -> Problem:
    """The problem with a residual for the prior of each nuisance; itself where it has none."""
    has_prior = ~problem.parameters.is_of_interest
    return ProblemWithPriors(problem=problem, has_prior=has_prior) if has_prior.any() else problem


def with_all_priors(problem: Problem) -> ProblemWithPriors:
    """The problem with a residual for the prior of every parameter, each once."""
    return ProblemWithPriors(problem=without_priors(problem))


def without_priors(problem: Problem) -> Problem:
    """The problem with the residuals of its data alone."""
    return problem.problem if isinstance(problem, ProblemWithPriors) else problem


def restricted(problem: Problem, fixed: Sequence[str], values: Array) -> RestrictedProblem:
    """The problem with the parameters named `fixed` fixed at their `values`, shape ``(n,)``.

    Raises
    ------
    ValueError
        If a name is not a parameter's or none is left free.
    """
    free = problem.parameters.with_fixed(fixed, values)
    if not free.free_indices:
        raise ValueError("all parameters are fixed; leave at least one free")
    return RestrictedProblem(problem=problem, free=free)


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
    return BoundedProblem(problem=problem, parameters=parameters)


# Singular values of a Jacobian below this share of the largest are rounding, not information.
RANK_TOLERANCE = 1e-10
# The same of the triangle that a step is made from: its columns are in conditional standard
# deviations, so that rounding alone is left, and a direction known to 1e10 of them still counts.
STEP_RANK_TOLERANCE = 1e-12
# The same where a quantity is called unseen by the data: in conditional standard deviations, with
# room for what the solver's own tolerance leaves in the derivatives.
UNSEEN_TOLERANCE = 1e-9
# The same share of the largest eigenvalue of the information, a singular value squared.
EIGENVALUE_TOLERANCE = 1e-10
# Share of the deviance that an impossible step may promise at a minimum on a kink, and how much of
# it where there are nuisances, whose priors make it one in units of the noise: a tenth of a
# standard deviation. Insertions that may be elsewhere lead onto kinks as a rule.
KINK_SHARE, KINK_DEVIANCE = 1e-6, 0.01
