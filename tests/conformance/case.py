"""A question whose answer is known, and what a tool answers to it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from identknee.calibrate.problem import Problem, Quantity
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, frozen

Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Formula:
    """A problem in a few lines of arithmetic, its residuals in units of their noise.

    Attributes
    ----------
    parameters
        Its parameters.
    residuals_at, jacobian_at
        Functions of theta, of shapes ``(m,)`` and ``(m, n)``. Where a residual is not finite the
        problem has no prediction.
    is_feasible
        Whether there is a prediction at theta; where there is none, `residuals_at` says what there
        would be if the model went on.
    """

    parameters: Parameters
    residuals_at: Callable[[Array], list[float] | Array]
    jacobian_at: Callable[[Array], list[list[float]] | Array]
    is_feasible: Callable[[Array], bool] = lambda _: True

    def residuals(self, theta: Array) -> Array:
        """Residuals at `theta`, shape ``(m,)``; all infinite where it is infeasible.

        So they are where one of them is not finite.
        """
        with np.errstate(all="ignore"):
            residuals = np.asarray(self.residuals_at(theta), dtype=np.float64)
        is_predicted = self.is_feasible(theta) and np.isfinite(residuals).all()
        return residuals if is_predicted else np.full(residuals.shape, np.inf)

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residuals, shape ``(m, n)``."""
        return np.asarray(self.jacobian_at(theta), dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A question with a known answer.

    The question: which values of a quantity do the data allow? The answer: the set of values at
    which the lowest deviance (the sum of squared residuals) within the bounds of all parameters is
    no more than the chi-square quantile of one degree of freedom above the lowest deviance of all.
    Where a model has no prediction the data exclude nothing: a value without any is not excluded,
    and parameter sets that are infeasible at a value count with the deviance that they would have
    if the model went on. An end that only the feasibility boundary makes is open.

    Attributes
    ----------
    name, about
        What it is called, and what a tool may get wrong in it.
    problem, quantity
        Of what, and about what.
    optimum
        Where the user's fit ended, shape ``(n,)``: the best point, unless the case is about fits
        that did not end there.
    intervals
        The set, lowest interval first. An end is infinite where it is open: values up to the
        bound, or of any size, are allowed.
    lower, upper
        Words for the two ends that are right: ``"closed"``, ``"open_at_bound"`` (the deviance
        still rises at the bound), ``"open_flat"`` (it does not) or ``"open_at_feasibility"`` (the
        model ends before the deviance has risen).
    verdict
        Words that are right: ``"identifiable"`` (both ends closed), ``"bounded_by_assumption"`` (a
        closed end hangs on the bound of another parameter), ``"one_sided"``,
        ``"practically_nonidentifiable"`` (both open), ``"structurally_suspect"`` (and the data do
        not depend on the quantity), or ``"multimodal"`` (more than one interval).
    level
        Confidence level.
    accuracy
        Largest error of a closed end, as a share of half the width of the interval, or of the
        distance to the optimum where the other end is open.
    """

    name: str
    about: str
    problem: Problem
    quantity: Quantity
    optimum: Array
    intervals: Intervals
    lower: frozenset[str]
    upper: frozenset[str]
    verdict: frozenset[str]
    level: float = 0.95
    accuracy: float = 1e-3

    def __post_init__(self) -> None:
        optimum = frozen(self.optimum, self.problem.parameters.n, name="the optimum")
        object.__setattr__(self, "optimum", optimum)

    @property
    def threshold(self) -> float:
        """How far above the lowest deviance a value is still allowed."""
        return float(chi2.ppf(self.level, 1))

    def half_width(self, interval: tuple[float, float]) -> float:
        """What errors of the ends of `interval` are shares of."""
        low, high = interval
        if np.isfinite(high - low):
            return 0.5 * (high - low)
        closed = low if np.isfinite(low) else high
        return abs(closed - self.quantity.evaluate(self.optimum)[0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """What a tool says about a case.

    Attributes
    ----------
    intervals
        The values it allows, lowest first, with infinite ends where it calls them open.
    lower, upper, verdict
        Its words for the ends and its verdict, translated to those of a case; None where it has
        none.
    warnings
        What the tool itself says against its answer; beside any of these a wrong answer is not
        silent.
    n_simulations
        Evaluations of the residuals, with or without their derivatives.
    """

    intervals: Intervals
    lower: str | None = None
    upper: str | None = None
    verdict: str | None = None
    warnings: tuple[str, ...] = ()
    n_simulations: int = 0


Tool = Callable[[Case], Answer]
