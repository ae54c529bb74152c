"""Least-squares problems: residuals as functions of parameters, priors, evaluations, quantities."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular, svd
from typing_extensions import override

from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.declare import OF_PARAMETER, Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.record import Outcome
from identknee.runs.words import unit_of

STIFFNESS_UNIT = "_kN"
STRAIN_UNIT = "_pct"
ROUNDING = 1e-13
# Change of the residuals by a typical step below which a parameter counts as without effect: the
# square of its inverse would overflow.
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

    Where the residuals do not change with a parameter, its typical step.
    """
    typical = typical_steps(parameters)
    size = np.linalg.norm(jacobian, axis=0)
    changes = size * typical
    known = changes > max(ROUNDING * np.max(changes, initial=0.0), UNSEEN)
    return np.where(known, 1.0 / np.where(known, size, 1.0), typical)


def floors(parameters: Parameters) -> Array:
    """The least admissible value of each parameter, shape ``(n,)``.

    Zero for stiffnesses and for parameters with a lognormal prior, minus infinity for the rest.
    """
    positive = [
        is_log or name.endswith(STIFFNESS_UNIT)
        for name, is_log in zip(parameters.names, parameters.is_log, strict=True)
    ]
    return np.where(positive, 0.0, -np.inf)


def values_by_unit(
    parameters: Parameters, stiffness: ArrayLike, strain: ArrayLike, others: Array
) -> Array:
    """Each parameter's value by its kind: stiffness in kN, strain in %, or another, ``(n,)``."""
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

    def residuals(self, theta: Array) -> Array:
        """Residuals at `theta`, shape ``(m,)``; all infinite where the model has no prediction."""

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals, shape ``(m, n)``; asked only where residuals are finite."""


@declared
class ProblemAround:
    """A problem made from another one; what a kind of it does not change is that of the other.

    Attributes
    ----------
    problem
        The other problem.
    """

    problem: Problem

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, shape ``(m,)``."""
        return self.problem.residuals(theta)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return self.problem.jacobian(theta)


@declared
class RestrictedProblem:
    """A problem in which only some parameters are free.

    Attributes
    ----------
    problem
        The problem in all parameters.
    free
        Its free parameters, and the values of the others.
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
    """A problem with other bounds of its parameters.

    Attributes
    ----------
    problem
        The problem.
    parameters
        Its parameters with the other bounds.
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
class SumOfTerms:
    """A problem whose deviance is the sum of those of several problems in the same parameters.

    Attributes
    ----------
    terms
        The problems by the kind of evidence, such as `TABLE_TERM`, in the order of their residuals.
    sizes
        Number of residuals of each.
    """

    terms: Mapping[str, Problem]
    sizes: tuple[int, ...]

    @property
    def parameters(self) -> Parameters:
        """The parameters, the same for every term."""
        return next(iter(self.terms.values())).parameters

    def residuals(self, theta: Array) -> Array:
        """Residuals of all terms, shape ``(m,)``; all infinite where one has no prediction."""
        found = np.concatenate([x.residuals(theta) for x in self.terms.values()])
        return found if np.isfinite(found).all() else np.full(found.shape, np.inf)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return np.vstack([x.jacobian(theta) for x in self.terms.values()])


def innermost(problem: Problem) -> Problem:
    """The problem without priors, bounds and fixed parameters."""
    while not isinstance(problem, SumOfTerms) and hasattr(problem, "problem"):
        problem = problem.problem
    return problem


@declared
class SelectedResiduals(ProblemAround):
    """Some of the residuals of a problem."""

    rows: IntArray

    @override
    def residuals(self, theta: Array) -> Array:
        """The residuals chosen, shape ``(k,)``."""
        return np.asarray(self.problem.residuals(theta)[self.rows])

    @override
    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(k, n)``."""
        return np.asarray(self.problem.jacobian(theta)[self.rows])


@declared
class WhitenedResiduals(ProblemAround):
    """A problem whose residuals are divided by the standard deviation of their noise."""

    sd: Array = array("Standard deviation of every residual", "residual")

    @override
    def residuals(self, theta: Array) -> Array:
        """Residuals in units of their noise, shape ``(m,)``."""
        return np.asarray(self.problem.residuals(theta) / self.sd)

    @override
    def jacobian(self, theta: Array) -> Array:
        """Their derivatives, shape ``(m, n)``."""
        return np.asarray(self.problem.jacobian(theta) / self.sd[:, None])


@declared
class ProblemWithPriors(ProblemAround):
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
        Which parameters have a residual for their prior, shape ``(n,)``; all if None.
    """

    has_prior: BoolArray | None = None

    @property
    def places(self) -> IntArray:
        """Indices of the parameters whose priors have a residual, shape ``(k,)``."""
        if self.has_prior is None:
            return np.arange(self.parameters.n)
        return np.flatnonzero(self.has_prior)

    @override
    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, then those of the priors, shape ``(m + k,)``.

        All are infinite where a parameter with a lognormal prior is not positive.
        """
        parameters, places = self.parameters, self.places
        is_log = parameters.is_log[places]
        data, values, center = self.problem.residuals(theta), theta[places], parameters.center
        if np.any(values[is_log] <= 0):
            return np.full(data.size + places.size, np.inf)
        rows = values - center[places]
        rows[is_log] = np.log(values[is_log] / center[places][is_log])
        return np.concatenate([data, rows / parameters.prior_sd[places]])

    @override
    def jacobian(self, theta: Array) -> Array:
        """Derivatives of residuals and prior rows by theta, shape ``(m + k, n)``."""
        parameters, places = self.parameters, self.places
        is_log, values = parameters.is_log[places], theta[places]
        slope = np.where(is_log, 1.0 / np.where(is_log, values, 1.0), 1.0)
        priors = np.zeros((places.size, parameters.n))
        priors[np.arange(places.size), places] = slope / parameters.prior_sd[places]
        return np.vstack([self.problem.jacobian(theta), priors])


def with_nuisance_priors(problem: Problem) -> Problem:
    """The problem with a residual for the prior of each nuisance; unchanged without nuisances."""
    has_prior = ~problem.parameters.is_of_interest
    return ProblemWithPriors(problem=problem, has_prior=has_prior) if has_prior.any() else problem


def with_all_priors(problem: Problem) -> ProblemWithPriors:
    """The problem with a residual for the prior of every parameter, each once."""
    return ProblemWithPriors(problem=without_priors(problem))


def with_priors_of(problem: Problem, other: Problem) -> Problem:
    """The problem with residuals for those of its parameters whose priors count in `other`."""
    if not isinstance(other, ProblemWithPriors):
        return problem
    names = [other.parameters.names[i] for i in other.places]
    has_prior = np.isin(problem.parameters.names, names)
    return ProblemWithPriors(problem=problem, has_prior=has_prior) if has_prior.any() else problem


def without_priors(problem: Problem) -> Problem:
    """The problem without residuals for priors."""
    return problem.problem if isinstance(problem, ProblemWithPriors) else problem


TABLE_TERM, LIGAMENT_TERM, NUISANCE_TERM = (
    "laxity table",
    "priors of ligament parameters",
    "priors of nuisance parameters",
)
FORCE_TERM, SUPERPOSITION_TERM = "measured forces", "superposition"
PLAUSIBILITY_TERM = "limits of plausibility"
# Terms about what is believed of any knee: their deviance is no misfit of measured data.
BELIEFS = (LIGAMENT_TERM, PLAUSIBILITY_TERM)


@declared
class EvidenceTerm:
    """A term of the deviance: a kind of evidence about the knee, and its share of the misfit."""

    name: str = entry(
        "Laxity table, measured forces, superposition (in-situ forces), limits of plausibility, "
        "priors of ligament parameters or of nuisances"
    )
    n: int = entry("Its values", unit="1")
    deviance: float = entry("Its sum of squared residuals", unit="1")
    share: float = entry("Its share of the deviance", unit="1")


def evidence_terms(problem: Problem, theta: Array) -> tuple[EvidenceTerm, ...]:
    """The terms of the deviance of a problem at theta, shape ``(n,)``; none without a prediction.

    Their deviances add up to that of the problem.
    """
    residuals = problem.residuals(theta)
    if not np.isfinite(residuals).all():
        return ()
    asked = np.zeros(0, bool)
    if isinstance(problem, ProblemWithPriors):
        asked = problem.parameters.is_of_interest[problem.places]
    data, priors = np.split(residuals, [residuals.size - asked.size])
    parts = {TABLE_TERM: data}
    if isinstance(whole_data := innermost(problem), SumOfTerms):
        ends = np.cumsum(whole_data.sizes)[:-1]
        parts = dict(zip(whole_data.terms, np.split(data, ends), strict=True))
    parts |= {LIGAMENT_TERM: priors[asked], NUISANCE_TERM: priors[~asked]}
    whole = sum_of_squares(residuals) or 1.0
    return tuple(
        EvidenceTerm(name=name, n=x.size, deviance=(part := sum_of_squares(x)), share=part / whole)
        for name, x in parts.items()
        if x.size
    )


def misfit_square(problem: Problem, theta: Array) -> float:
    """Sum of squares of the data and of the priors of nuisances; inf without a prediction."""
    terms = evidence_terms(problem, theta)
    return sum(x.deviance for x in terms if x.name not in BELIEFS) if terms else np.inf


def limit_rows(problem: Problem) -> slice:
    """Slice of the residuals that belong to limits of plausibility; empty without limits."""
    inner = innermost(problem)
    if not isinstance(inner, SumOfTerms) or PLAUSIBILITY_TERM not in inner.terms:
        return slice(0)
    i = list(inner.terms).index(PLAUSIBILITY_TERM)
    first = sum(inner.sizes[:i])
    return slice(first, first + inner.sizes[i])


def n_prior_rows(problem: Problem) -> int:
    """Number of residuals of priors, which are the last ones of the problem."""
    return problem.places.size if isinstance(problem, ProblemWithPriors) else 0


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
    """The problem with other bounds for the parameters named.

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


def with_room_doubled(problem: Problem, names: Sequence[str]) -> BoundedProblem:
    """The problem with bounds about twice as wide for the parameters named.

    A bound moves outward by its distance from zero, or by half the width of the range where that is
    more: 0 to 40 kN becomes 0 to 80 kN, and -15 to 15 % becomes -30 to 30 %. The lower bound of a
    parameter that cannot be negative is halved. A lower bound of zero stays, also for a nuisance,
    where it fixes the sign.
    """
    parameters = problem.parameters
    lower, upper = parameters.lower, parameters.upper
    half = 0.5 * (upper - lower)
    half = np.where(np.isfinite(half), half, 0.0)
    is_sign = (floors(parameters) == 0.0) | (~parameters.is_of_interest & (lower == 0.0))
    below = np.where(is_sign, 0.5 * lower, lower - np.maximum(np.abs(lower), half))
    above = upper + np.maximum(np.abs(upper), half)
    return BoundedProblem(
        problem=problem,
        parameters=parameters.with_bounds(
            {
                name: (float(below[i]), float(above[i]))
                for name in names
                for i in (parameters.index(name),)
            }
        ),
    )


# Share of the largest singular value of a Jacobian below which one is rounding.
RANK_TOLERANCE = 1e-10
# Rank tolerance of the triangular factor of a step. Its columns are in conditional standard
# deviations, which leaves rounding alone: a direction known to 1e10 of them still counts.
STEP_RANK_TOLERANCE = 1e-12
# Rank tolerance below which the data do not determine a quantity, in conditional standard
# deviations: above the error of derivatives by the solver's tolerance.
UNSEEN_TOLERANCE = 1e-9
# Rank tolerance of the information, as a share of its largest eigenvalue.
EIGENVALUE_TOLERANCE = 1e-10
# Predicted reduction of the deviance that a minimum on a kink may leave: as a share of it, and in
# units of the noise where priors of nuisances set that unit (a tenth of a standard deviation).
# Fits with uncertain insertions usually end on kinks.
KINK_SHARE, KINK_DEVIANCE = 1e-6, 0.01


# A secant update divides by the product of a step and the change of the gradient along it. Below
# this share of the product that the Jacobian predicts, that is rounding and there is no update.
LEAST_PRODUCT = 1e-8
# Share of the largest eigenvalue of the curvature below which a step leaves a direction out.
LEAST_EIGENVALUE = 1e-14
# Number of parameters above which factorisations dominate the time of a search, and are saved where
# possible. Below it they save nothing, and their rounding changes the way of a search on kinks.
LARGE = 128
# Least ratio of the smallest to the largest diagonal entry of a Cholesky factor that is used.
LEAST_ROOT = 1e-4


def clear_root(square: Array) -> Array | None:
    """The upper Cholesky factor of a matrix; None where it is not clear of rounding."""
    with suppress(np.linalg.LinAlgError):
        root = np.asarray(np.linalg.cholesky(square).T)
        diagonal = np.diagonal(root)
        if diagonal.min() > LEAST_ROOT * diagonal.max():
            return root
    return None


class LinearisedResiduals(Hashable, Protocol):
    """Residuals at a parameter vector, with their derivatives; told apart by identity."""

    @property
    def theta(self) -> Array:
        """The parameter vector, shape ``(n,)``."""

    @property
    def residuals(self) -> Array:
        """Residuals in units of their noise, shape ``(m,)``."""

    @property
    def jacobian(self) -> Array:
        """Derivatives of the residuals, shape ``(m, n)``."""


class Curvature:
    """Quasi-Newton estimate of the second-order term that Gauss-Newton omits.

    The term is the sum of the residuals times their second derivatives. Where it is not small
    beside the squared Jacobian, as in the bent valleys of uncertain geometry, Gauss-Newton steps
    overshoot several times; with the term they do not. It is estimated from changes of the gradient
    between points that the Jacobian does not explain, by a least-change secant update.

    References
    ----------
    J. E. Dennis, D. M. Gay and R. E. Welsch, An adaptive nonlinear least-squares algorithm, ACM
    Trans. Math. Softw. 7 (1981) 348-368, section 3, doi:10.1145/355958.355965.
    """

    def __init__(self, n: int) -> None:
        self._matrix = np.zeros((n, n))

    @property
    def is_known(self) -> bool:
        """Whether any update has been made."""
        return bool(self._matrix.any())

    def learn(self, before: LinearisedResiduals, after: LinearisedResiduals) -> None:
        """Update from two points with derivatives."""
        step = after.theta - before.theta
        gradient = after.jacobian.T @ after.residuals
        change = gradient - before.jacobian.T @ before.residuals
        wanted = gradient - before.jacobian.T @ after.residuals
        product = float(change @ step)
        scale = float(np.linalg.norm(after.jacobian @ step)) ** 2
        if product <= LEAST_PRODUCT * scale or scale == 0.0:
            return
        known = self._matrix @ step
        # Sizing: an estimate from elsewhere that is too large here is scaled down first.
        size = float(abs(step @ known))
        share = min(1.0, float(abs(step @ wanted)) / size) if size > 0.0 else 1.0
        missing = wanted - share * known
        ratio = np.outer(missing, change) / product
        self._matrix = (
            share * self._matrix
            + ratio
            + ratio.T
            - float(missing @ step) / product**2 * np.outer(change, change)
        )

    def model(self, at: LinearisedResiduals, scales: Array) -> tuple[Array, Array]:
        """Matrix and data whose sum of squares is the deviance around a point, up to a constant.

        In parameters divided by `scales`, shape ``(n,)``. A direction along which the deviance
        curves down counts as if it curved up as much, so that the lowest point of the model lies
        downhill and not at a saddle.
        """
        linear = at.jacobian * scales
        if not self.is_known:
            return linear, at.residuals
        square = linear.T @ linear + self._matrix * np.outer(scales, scales)
        slope = linear.T @ at.residuals
        root = clear_root(square) if slope.size > LARGE else None
        if root is not None:
            return root, np.asarray(solve_triangular(root, slope, trans="T"))
        values, vectors = np.linalg.eigh(square)
        sizes = np.abs(values)
        is_seen = sizes > LEAST_EIGENVALUE * sizes.max()
        roots = np.sqrt(np.where(is_seen, sizes, 1.0))
        slope = vectors.T @ slope
        matrix = np.where(is_seen, roots, 0.0)[:, None] * vectors.T
        return matrix, np.where(is_seen, slope / roots, 0.0)


# Number of the last simulations that an evaluator keeps.
REMEMBERED = 4
# Share of the deviance below which a jump of residuals without derivatives is rounding.
LEAST_JUMP = 1e-6
# Distance to the end of another search [units of the noise] within which one would end there too.
NEAR = 0.1


class SearchEnded(Exception):  # noqa: N818 - not an error: it says how a search ended
    """Raised inside a search to end it, whichever library owns the loop."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome)
        self.outcome = outcome


@declared
class Evaluation:
    """One simulation: residuals in units of their noise, and their exact derivatives."""

    theta: Array = array("The parameter vector", "parameter", unit=OF_PARAMETER)
    residuals: Array = array(
        "Residuals; all infinite where the model has no prediction", "residual"
    )
    jacobian: Array = array(
        "d residuals / d theta; NaN where the residuals are infinite", "residual", "parameter"
    )

    @property
    def is_finite(self) -> bool:
        """Whether the model has a prediction with derivatives here."""
        return bool(np.isfinite(self.residuals).all() and np.isfinite(self.jacobian).all())

    @property
    def deviance(self) -> float:
        """Sum of squared residuals: minus twice the log likelihood, up to a constant."""
        return float(self.residuals @ self.residuals) if self.is_finite else np.inf

    @property
    def gradient(self) -> Array:
        """Derivatives of the deviance by theta, shape ``(n,)``."""
        return np.asarray(2.0 * self.jacobian.T @ self.residuals)

    @property
    def information(self) -> Array:
        """Fisher information of theta, shape ``(n, n)``."""
        return np.asarray(self.jacobian.T @ self.jacobian)


def jump(before: Evaluation, after: Evaluation) -> float:
    """Change of the deviance between two points by residuals that have no derivatives.

    Such residuals are constant but for jumps, as those of trials without equilibrium. Only those
    without derivatives at both points count. 0 where the change is rounding.
    """
    is_flat = ~before.jacobian.any(axis=1) & ~after.jacobian.any(axis=1)
    first, last = before.residuals[is_flat], after.residuals[is_flat]
    change = float(last @ last - first @ first)
    return change if abs(change) > LEAST_JUMP * (1.0 + before.deviance) else 0.0


class Evaluator:
    """Evaluations of a problem within a budget of simulations.

    The residuals at a new theta are one simulation; their Jacobian there is not another. The last
    few thetas and the best one are remembered and cost nothing when asked for again.

    Parameters
    ----------
    problem
        What to evaluate.
    budget
        Simulations allowed; one more raises `SearchEnded`. No limit if None.
    on_simulation
        Called with 1 after every simulation, for a progress bar.
    ends
        Evaluations where other searches ended. `SearchEnded` is raised near one of them that is at
        least as low as the best so far, because this search would end there too.
    known
        Earlier evaluations of this problem. They count as simulations, but take no time.
    learns_curvature
        Whether searches estimate the second-order term also for a problem without nuisances.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        budget: int | None = None,
        on_simulation: Callable[[int], None] | None = None,
        ends: Sequence[Evaluation] = (),
        known: Sequence[Evaluation] = (),
        learns_curvature: bool = False,
    ) -> None:
        self._problem = problem
        self._ends, self._known = ends, known
        self._on_simulation = on_simulation
        self._recent: list[_Simulation] = []
        self._best: _Simulation | None = None
        self.budget = budget
        self.n_simulations = 0
        # Number of the simulation and deviance, at each improvement.
        self.history: list[tuple[int, float]] = []
        # Kept for all searches that use this evaluator, one after another.
        is_bent = learns_curvature or not problem.parameters.is_of_interest.all()
        self.curvature = Curvature(problem.parameters.n) if is_bent else None

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self._problem.parameters

    @property
    def best_theta(self) -> Array | None:
        """Where the lowest finite deviance was seen, shape ``(n,)``; None before the first."""
        return None if self._best is None else self._best.theta

    @property
    def best_deviance(self) -> float:
        """The lowest deviance seen; inf before the first finite one."""
        return np.inf if self._best is None else sum_of_squares(self._best.residuals)

    def __call__(self, theta: Array) -> Evaluation:
        """The evaluation at `theta`, shape ``(n,)``, with derivatives.

        Raises
        ------
        SearchEnded
            If the budget does not allow another simulation.
        """
        simulation = self._simulated(theta)
        if simulation.evaluation is None:
            simulation.evaluation = _differentiated(
                self._problem, simulation.theta, simulation.residuals
            )
        return simulation.evaluation

    def residuals(self, theta: Array) -> Array:
        """Residuals at `theta`, shape ``(m,)``, all infinite where one of them is not finite.

        Raises
        ------
        SearchEnded
            If the budget does not allow another simulation.
        """
        return self._simulated(theta).residuals

    def deviance(self, theta: Array) -> float:
        """Sum of squared residuals at `theta`; inf where the model has no prediction.

        Raises
        ------
        SearchEnded
            If the budget does not allow another simulation.
        """
        return sum_of_squares(self._simulated(theta).residuals)

    def _simulated(self, theta: Array) -> "_Simulation":
        for known in self._recent if self._best is None else (*self._recent, self._best):
            if np.array_equal(known.theta, theta):
                return known
        if self.budget is not None and self.n_simulations >= self.budget:
            raise SearchEnded(Outcome.BUDGET)
        # An earlier search ended nearby, and at least as low: this one would end there too.
        if self.n_simulations and any(
            sum_of_squares(x.jacobian @ (theta - x.theta)) <= NEAR**2
            for x in self._ends
            if x.deviance <= self.best_deviance
        ):
            raise SearchEnded(Outcome.VALLEY)
        theta = np.array(theta, dtype=np.float64)
        self.n_simulations += 1
        if self._on_simulation is not None:
            self._on_simulation(1)
        before = next((x for x in self._known if np.array_equal(x.theta, theta)), None)
        residuals = _residuals(self._problem, theta) if before is None else before.residuals
        simulation = _Simulation(theta=theta, residuals=residuals, evaluation=before)
        self._recent = [simulation, *self._recent[: REMEMBERED - 1]]
        deviance = sum_of_squares(simulation.residuals)
        if deviance < self.best_deviance:
            self._best = simulation
            self.history.append((self.n_simulations, deviance))
        return simulation


@dataclass(slots=True, kw_only=True, eq=False)
class _Simulation:
    """Residuals at a theta, and their derivatives once they were needed."""

    theta: Array
    residuals: Array
    evaluation: Evaluation | None = None


def evaluate(problem: Problem, theta: Array) -> Evaluation:
    """Residuals of the problem and their derivatives at `theta`, shape ``(n,)``."""
    theta = np.array(theta, dtype=np.float64)
    return _differentiated(problem, theta, _residuals(problem, theta))


def thin_svd(matrix: Array) -> tuple[Array, Array, Array]:
    """Left vectors, singular values and right vectors of a matrix, ``matrix = left size right``.

    By QR iterations. Divide and conquer, numpy's only method, need not converge where some columns
    are 1e-13 of the others, as those of slack ligaments are.
    """
    left, size, right = svd(matrix, full_matrices=False, check_finite=False, lapack_driver="gesvd")
    return left, size, right


def sum_of_squares(residuals: Array) -> float:
    """The deviance of residuals: their sum of squares; inf where one of them is not finite.

    Examples
    --------
    >>> sum_of_squares(np.array([3.0, 4.0]))
    25.0
    """
    return float(residuals @ residuals) if np.isfinite(residuals).all() else np.inf


def _residuals(problem: Problem, theta: Array) -> Array:
    """Residuals, all infinite where their sum of squares is not finite."""
    residuals = np.asarray(problem.residuals(theta), dtype=np.float64)
    is_finite = np.isfinite(sum_of_squares(residuals))
    return residuals if is_finite else np.full(residuals.shape, np.inf)


def _differentiated(problem: Problem, theta: Array, residuals: Array) -> Evaluation:
    if np.isfinite(residuals).all():
        jacobian = np.asarray(problem.jacobian(theta), dtype=np.float64)
    else:
        jacobian = np.full((residuals.size, theta.size), np.nan)
    return Evaluation(theta=theta, residuals=residuals, jacobian=jacobian)


# The cube root of the rounding error: the best step of central differences.
DIFFERENCE_STEP = float(np.cbrt(np.finfo(np.float64).eps))


class Quantity(Protocol):
    """A scalar function of theta with its derivatives."""

    @property
    def name(self) -> str:
        """Its name, for example ``"ACL force, trial 12"``."""

    @property
    def unit(self) -> str:
        """Its unit, for example ``"N"``; empty if it has none."""

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by theta, shape ``(n,)``; NaN where there is no prediction."""


@declared
class ParameterQuantity:
    """One of the parameters as a quantity.

    Attributes
    ----------
    parameters
        All parameters, in the order of theta.
    name
        Name of the parameter.

    Raises
    ------
    ValueError
        If there is no parameter of that name.
    """

    parameters: Parameters
    name: str

    def __post_init__(self) -> None:
        self.parameters.index(self.name)

    @property
    def unit(self) -> str:
        """The unit that the name ends in; empty where it ends in none."""
        return unit_of(self.name)

    @property
    def index(self) -> int:
        """Its index in theta."""
        return self.parameters.index(self.name)

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by theta, shape ``(n,)``."""
        gradient = np.zeros(self.parameters.n)
        gradient[self.index] = 1.0
        return float(theta[self.index]), gradient


@declared
class UserQuantity:
    """Any function of theta as a quantity.

    Attributes
    ----------
    name, unit
        Name and unit.
    function
        Value at theta, shape ``(n,)``; NaN where it has none.
    gradient
        Derivatives at theta, shape ``(n,)``. If None, central differences are used: the function is
        then also evaluated slightly outside the bounds, by a relative step of 6e-6, and one-sided
        differences are used where it has no value on the other side.
    """

    name: str
    unit: str
    function: Callable[[Array], float]
    gradient: Callable[[Array], Array] | None = None

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by theta, shape ``(n,)``; NaN where there is no value."""
        value = float(self.function(theta))
        if not np.isfinite(value):
            return np.nan, np.full(theta.size, np.nan)
        if self.gradient is not None:
            return value, np.asarray(self.gradient(theta), dtype=np.float64)
        return value, np.array([self._difference(theta, value, i) for i in range(theta.size)])

    def _difference(self, theta: Array, value: float, i: int) -> float:
        step = DIFFERENCE_STEP * max(1.0, abs(theta[i]))
        places, values = [theta[i]], [value]
        for sign in (-1.0, 1.0):
            moved = np.array(theta)
            moved[i] += sign * step
            there = float(self.function(moved))
            if np.isfinite(there):
                places.append(moved[i])
                values.append(there)
        if len(places) == 1:
            return np.nan
        # A central difference does not use the value in the middle.
        low, high = (0, 1) if len(places) == 2 else (1, 2)
        return float((values[high] - values[low]) / (places[high] - places[low]))


@declared
class RestrictedQuantity:
    """A quantity of all parameters of which only some are free.

    Attributes
    ----------
    quantity
        The quantity of all parameters.
    free
        The free parameters, and the values of the others.
    """

    quantity: Quantity
    free: FreeParameters

    @property
    def name(self) -> str:
        """That of the quantity."""
        return self.quantity.name

    @property
    def unit(self) -> str:
        """That of the quantity."""
        return self.quantity.unit

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """Value and gradient by the free parameters, shape ``(n_free,)``."""
        value, gradient = self.quantity.evaluate(self.free.expand(theta))
        return value, self.free.restrict(gradient)


def value_at(quantity: Quantity, theta: Array) -> tuple[float, Array]:
    """Value and gradient of a quantity at a fit.

    Raises
    ------
    ValueError
        If it has no value there: its trial has no equilibrium, or it is the centre of contact of a
        compartment that does not touch.
    """
    value, gradient = quantity.evaluate(theta)
    if not np.isfinite(value):
        raise unpredicted(quantity)
    return value, gradient


def unpredicted(quantity: Quantity) -> ValueError:
    """The error to raise if a quantity has no value at a fit."""
    return ValueError(f"{quantity.name} has no prediction at the fit; leave it out")
