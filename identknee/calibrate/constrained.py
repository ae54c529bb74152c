"""The best fit among the parameter sets that give a quantity a wanted value."""

from collections.abc import Callable

import numpy as np

from identknee.calibrate.bounded_step import Step, attainable, bounded_step
from identknee.calibrate.evaluation import Ended, Evaluation, Evaluator
from identknee.calibrate.kinks import Kinks, lowest_of_the_highest
from identknee.calibrate.quantity import Quantity
from identknee.calibrate.scales import conditional_sds
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import declared
from identknee.runs.outcome import Outcome

# Tolerance on the deviance: at a signed root of 2 this is 2.5e-9 of the root.
TOLERANCE = 1e-8
ROUNDING = 1e-13
MAX_STEPS = 60
# Share of the promised decrease that a step must keep, and that lets the next one be longer.
ENOUGH, GOOD = 1e-4, 0.75
SHORTER, LONGER = 0.25, 2.0
# Of a step across a kink that is not taken: its end is heeded in the next one.
HALF = 0.5
# In tolerances: how far below its height a step that heeds kinks may be said to lead.
GAP = 0.2
# In conditional standard deviations: a step below this is none.
SHORTEST = 1e-7
# The price of a missed target, in multiples of what hitting it costs.
PENALTY = 2.0

IsEnough = Callable[[Evaluation], bool]


@declared
class Constrained:
    """Where a constrained fit ended, and how.

    Attributes
    ----------
    evaluation
        The best parameter set found, its residuals and Jacobian.
    value
        The quantity there; NaN without a constraint.
    multiplier
        Derivative of the lowest deviance by the wanted value.
    tangent
        Derivative of theta along the path of constrained fits by the wanted value, shape ``(n,)``.
    is_held
        Which parameters a bound keeps from fitting better, shape ``(n,)``.
    outcome
        `MINIMUM` where no step within the bounds promises more than the tolerance, `CLIFF` where
        the way down has no prediction, `VALLEY` where it did not get that far, `BUDGET`, or
        `START_FAILED`.
    is_on_target
        Whether the quantity has the wanted value. A `MINIMUM` that is not on target is the end of
        the quantity's range: no small change within the bounds brings it closer.
    left
        How much lower one more step promises the deviance; infinite where none was planned.
    n_simulations
        Simulations made.
    """

    evaluation: Evaluation
    value: float
    multiplier: float
    tangent: Array
    is_held: BoolArray
    outcome: Outcome
    is_on_target: bool
    left: float
    n_simulations: int


def solve_constrained(
    evaluator: Evaluator,
    start: Array,
    *,
    quantity: Quantity,
    target: float,
    tolerance: float = TOLERANCE,
    most_steps: int = MAX_STEPS,
    is_enough: IsEnough | None = None,
) -> Constrained:
    """The parameter set of least deviance within the bounds at which the quantity is `target`.

    Gauss-Newton steps within the bounds and on the linearised constraint, kept to a box around the
    last point where the model went worse than promised or had no prediction.

    Parameters
    ----------
    evaluator
        Evaluator of residuals in units of their noise.
    start
        Where to begin, shape ``(n,)``; moved into the bounds. For a parameter's own value the start
        is put on target first, which costs nothing.
    quantity, target
        What is held, and at what value.
    tolerance
        Tolerance on the deviance, which is what one more step may still promise, and on the target,
        in conditional standard deviations.
    most_steps
        Steps allowed; it ends as a `VALLEY` after them.
    is_enough
        Asked of each simulation with a prediction; where it says yes, the search ends there as a
        `VALLEY`. It goes all the way if None.
    """
    search = _Search(evaluator, quantity, target, tolerance, is_enough)
    return search.run(np.asarray(start, dtype=np.float64), most_steps)


def minimise(
    evaluator: Evaluator,
    start: Array,
    *,
    tolerance: float = TOLERANCE,
    most_steps: int = MAX_STEPS,
    is_enough: IsEnough | None = None,
) -> Constrained:
    """The parameter set of least deviance within the bounds, reached downhill from `start`.

    Parameters
    ----------
    evaluator
        Evaluator of residuals in units of their noise.
    start
        Where to begin, shape ``(n,)``; moved into the bounds.
    tolerance
        Tolerance on the deviance: what one more step may still promise.
    most_steps
        Steps allowed; it ends as a `VALLEY` after them.
    is_enough
        Asked of each simulation with a prediction; where it says yes, the search ends there as a
        `VALLEY`. It goes all the way if None.
    """
    search = _Search(evaluator, None, np.nan, tolerance, is_enough)
    return search.run(np.asarray(start, dtype=np.float64), most_steps)


@declared
class _Point:
    """An evaluation with the quantity there."""

    evaluation: Evaluation
    value: float
    gradient: Array | None

    @property
    def is_finite(self) -> bool:
        return self.evaluation.is_finite and (
            self.gradient is None or bool(np.isfinite(self.gradient).all())
        )


@declared
class _Plan:
    """The step the model around a point wants, and what it promises."""

    theta: Array
    step: Step
    length: float
    reduction: float
    linear_reduction: float
    gap: float
    remaining: float
    is_boxed: bool


class _Search:
    """One search: its settings, its trust region and the price of missing the target."""

    def __init__(
        self,
        evaluator: Evaluator,
        quantity: Quantity | None,
        target: float,
        tolerance: float,
        is_enough: IsEnough | None,
    ) -> None:
        self._evaluator = evaluator
        self._quantity = quantity
        self._target = target
        self._tolerance = tolerance
        self._is_enough = is_enough or (lambda _: False)
        parameters = evaluator.parameters
        self._lower, self._upper = parameters.lower, parameters.upper
        self._radius = np.inf
        self._price = 0.0
        self._met_cliff = False
        self._curvature = evaluator.curvature
        self._kinks = Kinks()

    def run(self, start: Array, most_steps: int) -> Constrained:
        before = self._evaluator.n_simulations
        start = self._on_target(np.clip(start, self._lower, self._upper))
        try:
            point = self._point(start)
        except Ended as end:
            return _unsolved(start, end.outcome)
        if not point.is_finite:
            return self._result(point, None, Outcome.START_FAILED, before)
        for _ in range(most_steps):
            if self._is_enough(point.evaluation):
                return self._result(point, None, Outcome.VALLEY, before)
            plan = self._plan(point)
            if self._is_done(plan, point):
                met_cliff = plan.is_boxed and self._met_cliff
                outcome = Outcome.CLIFF if met_cliff else Outcome.MINIMUM
                return self._result(point, plan, outcome, before)
            try:
                point = self._next(point, plan)
            except Ended as end:
                return self._result(point, plan, end.outcome, before)
            if self._radius < SHORTEST:
                outcome = Outcome.CLIFF if self._met_cliff else Outcome.VALLEY
                return self._result(point, plan, outcome, before)
        return self._result(point, plan, Outcome.VALLEY, before)

    def _on_target(self, start: Array) -> Array:
        """The start with the target put in where the quantity is one of the parameters."""
        if self._quantity is None:
            return start
        value, gradient = self._quantity.evaluate(start)
        theta = np.array(start)
        if np.count_nonzero(gradient) == 1:
            i = int(np.flatnonzero(gradient)[0])
            if gradient[i] == 1.0 and value == start[i]:
                theta[i] = np.clip(self._target, self._lower[i], self._upper[i])
        return theta

    def _point(self, theta: Array) -> _Point:
        evaluation = self._evaluator(theta)
        if self._quantity is None or not evaluation.is_finite:
            return _Point(evaluation=evaluation, value=np.nan, gradient=None)
        value, gradient = self._quantity.evaluate(theta)
        return _Point(evaluation=evaluation, value=value, gradient=gradient)

    def _plan(self, point: _Point) -> _Plan:
        at = point.evaluation
        scales = conditional_sds(at.jacobian, self._evaluator.parameters)
        matrix, data = self._model(at, scales)
        low, high = (self._lower - at.theta) / scales, (self._upper - at.theta) / scales
        box = np.maximum(low, -self._radius), np.minimum(high, self._radius)
        constraint, gap, remaining = None, 0.0, 0.0
        if point.gradient is not None:
            normal = point.gradient * scales
            size = float(np.linalg.norm(normal))
            wanted = self._target - point.value
            reachable = attainable(normal, box, wanted)
            constraint = normal, reachable
            gap = abs(wanted) / size if size > 0 else (np.inf if wanted else 0.0)
            remaining = abs(wanted - reachable)
        step = bounded_step(matrix, data, box, constraint)
        reduction = linear_reduction = _reduction(matrix, data, step)
        if self._kinks.is_met:
            whole = bounded_step(matrix, data, (low, high), constraint)
            length = float(np.max(np.abs(whole.step), initial=0.0))
            models = self._kinks.models(at, scales, length=length, slack=self._tolerance)
            if len(models) > 1:
                step, height = lowest_of_the_highest(models, box, constraint, GAP * self._tolerance)
                reduction = linear_reduction = at.deviance - height
        if self._curvature is not None and self._curvature.is_known:
            linear = at.jacobian * scales
            by_it = bounded_step(linear, at.residuals, box, constraint)
            linear_reduction = _reduction(linear, at.residuals, by_it)
        theta = np.clip(at.theta + scales * step.step, self._lower, self._upper)
        theta = np.where(step.step == low, self._lower, theta)
        theta = np.where(step.step == high, self._upper, theta)
        length = float(np.max(np.abs(step.step), initial=0.0))
        return _Plan(
            theta=theta,
            step=step,
            length=length,
            reduction=reduction,
            linear_reduction=linear_reduction,
            gap=gap,
            remaining=remaining,
            is_boxed=length >= self._radius,
        )

    def _is_done(self, plan: _Plan, point: _Point) -> bool:
        tolerance = max(self._tolerance, ROUNDING * point.evaluation.deviance)
        if max(abs(plan.reduction), abs(plan.linear_reduction)) > tolerance:
            return False
        if point.gradient is None or plan.gap <= self._tolerance:
            return True
        # No step within the bounds brings the quantity closer.
        missing = abs(self._target - point.value)
        return not plan.is_boxed and missing - plan.remaining <= self._tolerance * missing

    def _next(self, point: _Point, plan: _Plan) -> _Point:
        """The next point: the planned one if it keeps enough of its promise."""
        new = self._point(plan.theta)
        if not new.is_finite:
            self._met_cliff = True
            self._radius = SHORTER * plan.length
            return point
        if self._curvature is not None:
            self._curvature.learn(point.evaluation, new.evaluation)
        missing = 0.0 if point.gradient is None else abs(self._target - point.value)
        self._price = max(self._price, PENALTY * 2.0 * abs(plan.step.multiplier))
        promised = plan.reduction + self._price * (missing - plan.remaining)
        kept = self._merit(point) - self._merit(new)
        rounding = ROUNDING * point.evaluation.deviance
        is_taken = promised <= 0 or kept >= ENOUGH * promised - rounding
        # Over uncertain geometry contact is rounded, and its bends are learned instead.
        if self._curvature is None and kept <= GOOD * promised:
            self._kinks.remember((point if is_taken else new).evaluation)
        if not is_taken:
            self._radius = (HALF if self._curvature is None else SHORTER) * plan.length
            return point
        if kept > GOOD * promised and plan.is_boxed:
            self._radius *= LONGER
        self._met_cliff = self._met_cliff and np.isfinite(self._radius)
        return new

    def _model(self, at: Evaluation, scales: Array) -> tuple[Array, Array]:
        """Matrix and data of the model of the deviance around a point."""
        if self._curvature is None:
            return at.jacobian * scales, at.residuals
        return self._curvature.model(at, scales)

    def _merit(self, point: _Point) -> float:
        missing = 0.0 if point.gradient is None else abs(self._target - point.value)
        return point.evaluation.deviance + self._price * missing

    def _result(
        self, point: _Point, plan: _Plan | None, outcome: Outcome, before: int
    ) -> Constrained:
        n = point.evaluation.theta.size
        held = np.zeros(n, dtype=np.bool_)
        tangent = np.full(n, np.nan)
        if plan is not None:
            theta = plan.theta
            at_bound = (theta <= self._lower) | (theta >= self._upper)
            held = plan.step.is_held & at_bound
            if point.gradient is not None:
                tangent = self._tangent(point, held)
        return Constrained(
            evaluation=point.evaluation,
            value=point.value,
            multiplier=np.nan if plan is None else 2.0 * plan.step.multiplier,
            tangent=tangent,
            is_held=held,
            outcome=outcome,
            is_on_target=plan is not None and plan.gap <= self._tolerance,
            left=np.inf if plan is None else plan.reduction,
            n_simulations=self._evaluator.n_simulations - before,
        )

    def _tangent(self, point: _Point, held: BoolArray) -> Array:
        """The way of least rise by which the quantity grows by one, held parameters staying."""
        gradient = point.gradient
        if gradient is None:  # pragma: no cover - asked for with a quantity only
            raise AssertionError
        scales = conditional_sds(point.evaluation.jacobian, self._evaluator.parameters)
        limit = np.where(held, 0.0, np.inf)
        # Rows of data are the parameters' own steps, so the linear model is d theta / d value.
        matrix, _ = self._model(point.evaluation, scales)
        normal = gradient * scales
        if not np.any(normal[~held]):
            return np.zeros(normal.size)
        size = float(np.linalg.norm(normal[~held]))
        step = bounded_step(
            matrix, np.zeros(len(matrix)), (-limit, limit), (normal / size, 1.0)
        ).step
        return np.asarray(scales * step / size)


def _reduction(matrix: Array, data: Array, step: Step) -> float:
    """How much lower a model has the deviance after its step."""
    change = matrix @ step.step
    return float(-2.0 * data @ change - change @ change)


def _unsolved(start: Array, outcome: Outcome) -> Constrained:
    n = start.size
    evaluation = Evaluation(
        theta=start, residuals=np.full(1, np.inf), jacobian=np.full((1, n), np.nan)
    )
    return Constrained(
        evaluation=evaluation,
        value=np.nan,
        multiplier=np.nan,
        tangent=np.full(n, np.nan),
        is_held=np.zeros(n, dtype=np.bool_),
        outcome=outcome,
        is_on_target=False,
        left=np.inf,
        n_simulations=0,
    )
