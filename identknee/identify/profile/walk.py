"""The points of a profile, and what one tells of the next."""

from dataclasses import dataclass

import numpy as np

from identknee.calibrate.constrained import (
    MAX_STEPS,
    TOLERANCE,
    Constrained,
    IsEnough,
    solve_constrained,
)
from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.identify.detours import fit_around, promised_reduction
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.outcome import Outcome

# Of the threshold: a lower deviance than the optimum's by more than this starts a profile over.
BETTER = 1e-4
# Of the threshold: what a fit that the feasibility boundary stopped may promise unheeded.
CUT_OFF = 5e-2
# How much farther than the last step the path may be extended by its curvature.
FARTHEST = 2.5


class BetterFound(Exception):  # noqa: N818 - not an error: a profile met a better fit
    """Raised where a profile meets a point clearly lower than its optimum."""

    def __init__(self, theta: Array) -> None:
        super().__init__(theta)
        self.theta = theta


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Point:
    """One constrained fit on a profile.

    Attributes
    ----------
    value
        The quantity.
    evaluation
        The simulation there.
    slope
        Derivative of the lowest deviance by the value.
    tangent
        Derivative of theta by the value, shape ``(n,)``.
    is_held
        Parameters on a bound, shape ``(n,)``.
    promise
        How much lower the fit could be by its slopes, had every parameter set a prediction; next to
        nothing unless the feasibility boundary of the model stopped the fit.
    left
        How much lower the next step of the fit promised to go.
    """

    value: float
    evaluation: Evaluation
    slope: float
    tangent: Array
    is_held: BoolArray
    promise: float
    left: float

    @property
    def curvature(self) -> float:
        """Half the second derivative of the deviance by the value, by Gauss and Newton."""
        change = self.evaluation.jacobian @ self.tangent
        return float(change @ change)


class Walk:
    """What all points of a profile share: the quantity, the threshold and the lowest deviance.

    Parameters
    ----------
    evaluator
        Problem whose residuals are in units of their noise.
    quantity
        What is profiled.
    threshold
        Rise of the deviance that bounds the set.
    optimum
        The best fit. A slightly lower deviance met later takes the place of its own.
    """

    def __init__(
        self, evaluator: Evaluator, quantity: Quantity, threshold: float, optimum: Evaluation
    ) -> None:
        self.evaluator = evaluator
        self.quantity = quantity
        self.threshold = threshold
        self.lowest = optimum.deviance
        self.is_final = False
        # At the feasibility boundary a slightly better fit is always met.
        is_settled = promised_reduction(evaluator, optimum, None) <= CUT_OFF * threshold
        self._better = (BETTER if is_settled else CUT_OFF) * threshold
        parameters = evaluator.parameters
        self.limits = (-np.inf, np.inf)
        if isinstance(quantity, ParameterQuantity):
            i = quantity.index
            self.limits = (float(parameters.lower[i]), float(parameters.upper[i]))

    def delta(self, point: Point) -> float:
        """How far the deviance of a point is above the lowest."""
        return point.evaluation.deviance - self.lowest

    def solve(
        self,
        value: float,
        start: Array,
        *,
        tolerance: float = TOLERANCE,
        most_steps: int = MAX_STEPS,
        is_enough: IsEnough | None = None,
    ) -> Constrained:
        """The constrained fit at a value.

        Raises
        ------
        BetterFound
            If it is clearly better than the optimum.
        """
        solved = solve_constrained(
            self.evaluator,
            start,
            quantity=self.quantity,
            target=value,
            tolerance=tolerance,
            most_steps=most_steps,
            is_enough=is_enough,
        )
        self.note(solved.evaluation)
        return solved

    def solve_around(
        self, value: float, at: Evaluation, *, tolerance: float = TOLERANCE
    ) -> Constrained | None:
        """The constrained fit at a value from points around `at`, where there is one.

        Raises
        ------
        BetterFound
            If it is clearly better than the optimum.
        """
        solved = fit_around(
            self.evaluator,
            at,
            quantity=self.quantity,
            target=value,
            rise=self.threshold,
            tolerance=tolerance,
        )
        if solved is not None:
            self.note(solved.evaluation)
        return solved

    def point(self, solved: Constrained) -> Point:
        """The point of a profile that a constrained fit is."""
        at = solved.evaluation
        promise = solved.left
        # A budget used up before the first simulation leaves nothing to judge by.
        if at.is_finite and solved.outcome is not Outcome.MINIMUM:
            promise = promised_reduction(self.evaluator, at, self.quantity.evaluate(at.theta)[1])
        return Point(
            value=solved.value,
            evaluation=at,
            slope=solved.multiplier,
            tangent=solved.tangent,
            is_held=solved.is_held,
            promise=promise,
            left=solved.left,
        )

    def is_settled(self, point: Point) -> bool:
        """Whether no better fit lies beyond the feasibility boundary of the model."""
        return point.promise <= CUT_OFF * self.threshold

    def note(self, evaluation: Evaluation) -> None:
        """Compare a fit with the optimum.

        Raises
        ------
        BetterFound
            If it is clearly better.
        """
        if not self.is_final and evaluation.deviance < self.lowest - self._better:
            raise BetterFound(evaluation.theta)
        self.lowest = min(self.lowest, evaluation.deviance)

    def start(self, value: float, last: Point, other: Point | None) -> Array:
        """Theta expected at a value: along the tangent of `last`, bent toward `other`, (n,)."""
        step = value - last.value
        theta = last.evaluation.theta + last.tangent * step
        if other is not None and abs(step) <= FARTHEST * abs(other.value - last.value):
            back = other.value - last.value
            bend = other.evaluation.theta - last.evaluation.theta - last.tangent * back
            theta = theta + bend * (step / back) ** 2
        parameters = self.evaluator.parameters
        return np.asarray(np.clip(theta, parameters.lower, parameters.upper))


def step_to(rise: float, slope: float, curvature: float) -> float:
    """How far a parabola goes before it has risen; infinite where it never does.

    Parameters
    ----------
    rise
        How much higher, > 0.
    slope, curvature
        First derivative, and half the second, >= 0.

    Examples
    --------
    >>> step_to(4.0, 0.0, 1.0)
    2.0
    """
    root = np.sqrt(slope**2 + 4.0 * curvature * rise)
    # The form without a difference of nearly equal numbers.
    if slope >= 0:
        return float(2.0 * rise / (slope + root)) if slope + root > 0 else np.inf
    return float((root - slope) / (2.0 * curvature)) if curvature > 0 else np.inf
