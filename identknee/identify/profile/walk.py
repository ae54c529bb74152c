"""Stepping along a profile, interpolation between fits, and its ends."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identknee.calibrate.bounded_least_squares import (
    MAX_STEPS,
    TOLERANCE,
    ConstrainedFit,
    IsEnough,
    bounded_step,
    minimise,
    solve_constrained,
    walk_to_constraint,
)
from identknee.calibrate.problem import (
    Evaluation,
    Evaluator,
    ParameterQuantity,
    Quantity,
    SearchEnded,
    conditional_sds,
    thin_svd,
)
from identknee.identify.profile.result import EndOrigin, Side, SideStatus, crossings
from identknee.runs.declare import Array, BoolArray
from identknee.runs.record import Outcome

# Points tried until one has a prediction, and fits made from those that have one.
N_TRIED = 48
N_FITS = 2
MOST_STEPS = 24
# Seed of the directions in which points are tried: the same ones every time.
SEED = 20
# Along directions that the data hardly see, steps are no longer than the inverse of this, in
# conditional standard deviations.
LEAST_SIZE = 0.05


def fit_from_nearby(
    evaluator: Evaluator,
    at: Evaluation,
    *,
    quantity: Quantity | None,
    target: float,
    rise: float,
    tolerance: float,
) -> ConstrainedFit | None:
    """The lowest fit found from points around `at`, None where none of them has a prediction.

    The points lie where the linear model expects the deviance to rise by no more than `rise` above
    its lowest on the plane of the target, nearest first. The first fit that ends at a minimum is
    taken; one that stops at the feasibility boundary is tried again from one other point.

    Parameters
    ----------
    evaluator
        Evaluator of residuals in units of their noise.
    at
        A simulation with a prediction.
    quantity, target
        What is held, and at what value; `target` means nothing where `quantity` is None.
    rise
        Rise of the deviance up to which points are tried.
    tolerance
        Tolerance on the deviance, as for `solve_constrained`.
    """
    best: ConstrainedFit | None = None
    n_fits = 0
    for theta in _points_around(evaluator, at, quantity, target, rise):
        try:
            if not evaluator(theta).is_finite:
                continue
        except SearchEnded:
            return best
        if quantity is None:
            end = minimise(evaluator, theta, tolerance=tolerance, most_steps=MOST_STEPS)
        else:
            end = solve_constrained(
                evaluator,
                theta,
                quantity=quantity,
                target=target,
                tolerance=tolerance,
                most_steps=MOST_STEPS,
            )
        n_fits += 1
        arrived = quantity is None or end.is_on_target
        if arrived and (best is None or end.evaluation.deviance < best.evaluation.deviance):
            best = end
        if n_fits == N_FITS or (arrived and end.outcome is Outcome.MINIMUM):
            break
    return best


def linear_reduction_bound(evaluator: Evaluator, at: Evaluation, gradient: Array | None) -> float:
    """Reduction predicted by the linear model if every point had a prediction.

    Parameters
    ----------
    evaluator
        Evaluator of the residuals; its parameters' bounds are kept.
    at
        The simulation from which the model is linear.
    gradient
        Gradient of what is held, shape ``(n,)``; None where nothing is.
    """
    scales, bounds = _scaled_room(evaluator, at)
    matrix = at.jacobian * scales
    plane = None if gradient is None else (gradient * scales, 0.0)
    change = matrix @ bounded_step(matrix, at.residuals, bounds, plane).step
    return float(-2.0 * at.residuals @ change - change @ change)


def _scaled_room(evaluator: Evaluator, at: Evaluation) -> tuple[Array, tuple[Array, Array]]:
    parameters = evaluator.parameters
    scales = conditional_sds(at.jacobian, parameters)
    return scales, ((parameters.lower - at.theta) / scales, (parameters.upper - at.theta) / scales)


def _points_around(
    evaluator: Evaluator, at: Evaluation, quantity: Quantity | None, target: float, rise: float
) -> Array:
    """Points on the plane of the target, nearest its lowest first, shape ``(N_TRIED, n)``."""
    parameters = evaluator.parameters
    scales, bounds = _scaled_room(evaluator, at)
    matrix = at.jacobian * scales
    basis, plane = np.eye(parameters.n), None
    if quantity is not None:
        value, gradient = quantity.evaluate(at.theta)
        normal = gradient * scales
        if normal.any():
            plane = normal, target - value
            basis = np.linalg.qr(normal[:, None], mode="complete")[0][:, 1:]
    center = bounded_step(matrix, at.residuals, bounds, plane).step
    padded = np.vstack([matrix @ basis, np.zeros((basis.shape[1], basis.shape[1]))])
    _, sizes, directions = thin_svd(padded)
    spread = basis @ (directions.T / np.maximum(sizes, LEAST_SIZE))
    draws = np.random.default_rng(SEED).standard_normal((N_TRIED, basis.shape[1]))
    draws /= np.maximum(np.linalg.norm(draws, axis=1, keepdims=True), 1e-300)
    radii = np.sqrt(rise * np.arange(N_TRIED) / N_TRIED)
    steps = center + radii[:, None] * (draws @ spread.T)
    points: Array = np.clip(at.theta + scales * steps, parameters.lower, parameters.upper)
    return points


# Share of the threshold: a deviance lower than the optimum's by more restarts the profile. Beside
# nuisances and at the feasibility boundary a little is gained often, and the ends are moved.
BETTER, CLEARLY_BETTER = 1e-4, 5e-2
# Share of the threshold: reduction that a fit at the feasibility boundary may leave.
CUT_OFF = 5e-2
# How much farther than the last step the path may be extended by its curvature.
FARTHEST = 2.5


class BetterOptimumFound(Exception):  # noqa: N818 - not an error: a profile met a better fit
    """Raised where a profile meets a point clearly lower than its optimum."""

    def __init__(self, theta: Array) -> None:
        super().__init__(theta)
        self.theta = theta


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProfilePoint:
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
    predicted_reduction
        How much lower the fit could be by its slopes, had every parameter set a prediction; next to
        nothing unless the feasibility boundary of the model stopped the fit.
    left
        Reduction predicted for the next step of the fit.
    """

    value: float
    evaluation: Evaluation
    slope: float
    tangent: Array
    is_held: BoolArray
    predicted_reduction: float
    left: float

    @property
    def curvature(self) -> float:
        """Half the Gauss-Newton second derivative of the deviance by the value."""
        change = self.evaluation.jacobian @ self.tangent
        return float(change @ change)


class ProfileContext:
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
        The best fit. Rises are above its deviance, also where a slightly lower one is met later.
    """

    def __init__(
        self, evaluator: Evaluator, quantity: Quantity, threshold: float, optimum: Evaluation
    ) -> None:
        self.evaluator = evaluator
        self.quantity = quantity
        self.threshold = threshold
        self.lowest = optimum.deviance
        # The lowest fit met, the optimum to begin with.
        self.best = optimum
        self.is_final = False
        parameters = evaluator.parameters
        is_settled = linear_reduction_bound(evaluator, optimum, None) <= CUT_OFF * threshold
        is_short = is_settled and parameters.is_of_interest.all()
        self.least_gain = (BETTER if is_short else CLEARLY_BETTER) * threshold
        self.limits = (-np.inf, np.inf)
        if isinstance(quantity, ParameterQuantity):
            i = quantity.index
            self.limits = (float(parameters.lower[i]), float(parameters.upper[i]))

    def delta(self, point: ProfilePoint) -> float:
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
        near: Array | None = None,
    ) -> ConstrainedFit:
        """The constrained fit at a value; walked to from `near` where the start has no prediction.

        Raises
        ------
        BetterOptimumFound
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
        if solved.outcome is Outcome.START_FAILED and near is not None:
            solved = walk_to_constraint(
                self.evaluator,
                near,
                quantity=self.quantity,
                target=value,
                tolerance=tolerance,
                most_steps=most_steps,
            )
        self.note(solved.evaluation)
        return solved

    def solve_around(
        self, value: float, at: Evaluation, *, tolerance: float = TOLERANCE
    ) -> ConstrainedFit | None:
        """The constrained fit at a value from points around `at`, where there is one.

        Raises
        ------
        BetterOptimumFound
            If it is clearly better than the optimum.
        """
        solved = fit_from_nearby(
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

    def point(self, solved: ConstrainedFit) -> ProfilePoint:
        """The point of a profile that a constrained fit is."""
        at = solved.evaluation
        predicted_reduction = solved.left
        # A budget used up before the first simulation leaves nothing to judge by.
        if at.is_finite and solved.outcome is not Outcome.MINIMUM:
            predicted_reduction = linear_reduction_bound(
                self.evaluator, at, self.quantity.evaluate(at.theta)[1]
            )
        return ProfilePoint(
            value=solved.value,
            evaluation=at,
            slope=solved.multiplier,
            tangent=solved.tangent,
            is_held=solved.is_held,
            predicted_reduction=predicted_reduction,
            left=solved.left,
        )

    def is_settled(self, point: ProfilePoint) -> bool:
        """Whether no better fit lies beyond the feasibility boundary of the model."""
        return point.predicted_reduction <= CUT_OFF * self.threshold

    def note(self, evaluation: Evaluation) -> None:
        """Compare a fit with the optimum.

        Raises
        ------
        BetterOptimumFound
            If it is clearly better.
        """
        if evaluation.deviance >= self.best.deviance:
            return
        self.best = evaluation
        if self.is_final:
            self.lowest = min(self.lowest, evaluation.deviance)
        elif evaluation.deviance < self.lowest - self.least_gain:
            raise BetterOptimumFound(evaluation.theta)

    def start(self, value: float, last: ProfilePoint, other: ProfilePoint | None) -> Array:
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
    """The step at which a parabola has risen by `rise`; infinite if never.

    Parameters
    ----------
    rise
        The rise, > 0.
    slope, curvature
        First derivative, and half the second, >= 0.

    Examples
    --------
    >>> step_to(4.0, 0.0, 1.0)
    2.0
    """
    root = np.sqrt(slope**2 + 4.0 * curvature * rise)
    # This form avoids cancellation.
    if slope >= 0:
        return float(2.0 * rise / (slope + root)) if slope + root > 0 else np.inf
    return float((root - slope) / (2.0 * curvature)) if curvature > 0 else np.inf


POINTS_PER_SIDE = 5
MOST_POINTS = 80
LONGER = 2.5
# A bounded side is crossed in at least so many steps, so that none skips a narrow feature.
STEPS_ACROSS = 6
# Shares of the threshold: tolerance of fits on the curve and at an end, and the rise beyond which
# the next fit is meant to be the end.
ON_CURVE, AT_END, NEAR_END = 1e-3, 2e-4, 0.9
# Tolerances by which a tight fit may lie above its minimum, since slopes mislead beside a kink.
LEFT = 3.0
# Share of the root of the threshold within which the slope is extrapolated to the end, and the
# relative error of a slope beside a kink.
CLOSE, SLOPE_ERROR = 2e-3, 0.1
# Share of the distance to the optimum.
END_TOLERANCE = 1e-4
GAP_TOLERANCE = 1e-3
BESIDE_BOUND = 1e-3
# Of a bound: what is nearer is taken to be at it.
ROUNDING = 1e-13
# Of the threshold: what a flat side may still rise by going as far again.
FLAT = 1e-2
# An unbounded side is flat where it is over so many first steps.
FAR = 1e4
# Of the threshold, what tells a jump to another local fit from a bend: how far from where it was
# expected, in squared standard deviations, and how much higher or lower than the slopes say.
JUMP = 0.25
MISMATCH = 0.02
MOST_RETRIES = 4
# How far to leap over values without prediction, in steps; and how often a side looks for other
# points with the same value.
LEAPS = (2.0, 4.0, 8.0)
MOST_DETOURS = 4
# How often a side walks to a value and is stopped on the way.
MOST_STUCK = 3
# Of the threshold: a fit stopped at the boundary excludes its value where the rise stays above this
# after the predicted reduction.
ENOUGH = 0.9


# Whether the profile is known from a point on.
IsKnown = Callable[[ProfilePoint], bool]

# What makes an open end; what makes a closed one is found out when all paths are known.
OPEN_ENDS = {
    SideStatus.OPEN_AT_BOUND: EndOrigin.OWN_BOUND,
    SideStatus.OPEN_AT_FEASIBILITY: EndOrigin.FEASIBILITY,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideWalk:
    """The profile on one side.

    Attributes
    ----------
    points
        In the order found, the origin first.
    side
        How it ended.
    """

    points: tuple[ProfilePoint, ...]
    side: Side


def march(
    walk: ProfileContext, origin: ProfilePoint, direction: int, *, is_known: IsKnown | None = None
) -> SideWalk:
    """The profile on one side of an optimum, until its deviance has risen by the threshold.

    Steps aim at equal rises of the deviance's root, by the parabola through the last point with its
    exact slope and Gauss-Newton curvature; theta is expected along the path's tangent and bend.
    The end is solved for: once a point lies beyond it, the cubic between the two nearest points
    gives the next, until one fitted tightly has a root right to 2e-3 of it, from where its slope
    leads to the end.

    Where the path meets the feasibility boundary, beyond which a trial has no prediction, the fit
    is begun again from other points with the same value, and then farther out. The side ends there
    only where none of them has a prediction.

    Parameters
    ----------
    walk
        The quantity, the threshold and the lowest deviance.
    origin
        The optimum, or another point to begin at.
    direction
        1 for upward, -1 for downward.
    is_known
        Asked of each point within the set; where it says yes, the rest of the side is known, and
        the side ends there.
    """
    return _March(walk, origin, direction, is_known or (lambda _: False)).run()


class _March:
    def __init__(
        self, walk: ProfileContext, origin: ProfilePoint, direction: int, is_known: IsKnown
    ) -> None:
        self._walk = walk
        self._is_known = is_known
        self._direction = direction
        self._points = [origin]
        self._inside = origin
        self._outside: ProfilePoint | None = None
        self._blocked: float | None = None
        self._is_gap = False
        self._bound = walk.limits[1 if direction > 0 else 0]
        self._root = float(np.sqrt(walk.threshold))
        self._n_refined = self._n_retries = self._n_detours = self._n_stuck = 0
        step = step_to(self._walk.threshold / POINTS_PER_SIDE**2, 0.0, origin.curvature)
        low, high = self._walk.limits
        if step < high - low:
            self._unit = step
        else:
            room = abs(self._bound - origin.value)
            self._unit = room / STEPS_ACROSS if np.isfinite(room) else max(abs(origin.value), 1.0)

    def run(self) -> SideWalk:
        for _ in range(MOST_POINTS):
            side = self._ended()
            if side is None:
                side = self._go_on()
            if side is not None:
                return SideWalk(points=tuple(self._points), side=side)
        return SideWalk(points=tuple(self._points), side=self._open(SideStatus.OPEN_BUDGET))

    # The next value.

    def _go_on(self) -> Side | None:
        value = self._next_value()
        behind = self._outside or (self._points[-2] if len(self._points) > 1 else None)
        start = self._walk.start(value, self._inside, behind)
        is_near_end = self._outside is not None or (
            self._walk.delta(self._inside) > NEAR_END * self._walk.threshold
        )
        tolerance = self._walk.threshold * (AT_END if is_near_end else ON_CURVE)
        solved = self._solved(value, start, tolerance)
        if solved.outcome is Outcome.BUDGET:
            return self._open(SideStatus.OPEN_BUDGET)
        if not np.isfinite(solved.evaluation.deviance):
            return self._cross_gap(value, tolerance)
        if not solved.is_on_target:
            # The end of the range, a gap or a failure.
            if solved.outcome is Outcome.MINIMUM:
                point = self._walk.point(solved)
                self._bound = point.value
                if self._direction * (point.value - self._inside.value) <= 0:
                    return self._at_bound()
                self._accept(point)
                return None
            if solved.outcome is Outcome.CLIFF:
                return self._cross_gap(value, tolerance)
            self._blocked = value
            return None
        point = self._walk.point(solved)
        if solved.outcome is Outcome.CLIFF and self._mismatch(point, start) > self._walk.threshold:
            # The feasibility boundary keeps it in another valley, far above this one.
            return self._cross_gap(value, tolerance)
        self._take(point, start)
        return None

    def _solved(self, value: float, start: Array, tolerance: float) -> ConstrainedFit:
        """The constrained fit at a value, from other points too where the model ends on the way."""
        walk, inside = self._walk, self._inside.evaluation
        near = inside.theta if self._n_stuck < MOST_STUCK else None
        solved = walk.solve(value, start, tolerance=tolerance, near=near)
        if solved.outcome is Outcome.CLIFF and not solved.is_on_target:
            self._n_stuck += 1
        if self._n_detours == MOST_DETOURS:
            return solved
        # Whether the feasibility boundary kept a fit from being made or from going lower.
        if solved.is_on_target:
            is_limited = not walk.is_settled(walk.point(solved))
        else:
            is_limited = solved.outcome in {Outcome.START_FAILED, Outcome.CLIFF}
        if not is_limited:
            return solved
        self._n_detours += 1
        around = walk.solve_around(value, inside, tolerance=tolerance)
        if around is None or (
            solved.is_on_target and solved.evaluation.deviance <= around.evaluation.deviance
        ):
            return solved
        return around

    def _cross_gap(self, value: float, tolerance: float) -> Side | None:
        """Continue beyond a gap without predictions if there are fits beyond; else step back."""
        is_new = not self._is_gap
        self._blocked, self._is_gap = value, True
        if self._outside is not None:
            # What lies beyond is excluded, and what lies between has no prediction.
            self._n_retries += 1
            if self._n_retries > MOST_RETRIES:
                outside = self._outside
                return self._closed(outside, outside.value, abs(outside.value - self._inside.value))
            return None
        if not is_new:
            return None
        at = self._inside
        for leap in LEAPS:
            farther = at.value + leap * (value - at.value)
            if self._direction * (farther - self._bound) > 0:
                break
            solved = self._solved(farther, self._walk.start(farther, at, None), tolerance)
            if solved.outcome is Outcome.BUDGET:
                return self._open(SideStatus.OPEN_BUDGET)
            if solved.is_on_target and np.isfinite(solved.evaluation.deviance):
                point = self._walk.point(solved)
                self._accept(point)
                if self._inside is point:
                    self._blocked, self._is_gap = None, False
                break
        return None

    def _next_value(self) -> float:
        if self._outside is not None:
            if self._blocked is not None:
                return 0.5 * (self._blocked + self._outside.value)
            return self._refined(self._outside)
        at = self._inside
        root = self._z(at)
        spacing = self._root / POINTS_PER_SIDE
        goal = self._root if root + 1.4 * spacing > self._root else root + spacing
        step = step_to(goal**2 - self._walk.delta(at), self._direction * at.slope, at.curvature)
        if not self._walk.is_settled(at):
            # The slope is that of the boundary.
            step = max(step, self._unit)
        last = self._unit
        if len(self._points) > 1:
            last = max(LONGER * abs(self._points[-1].value - self._points[-2].value), self._unit)
        most = abs(self._bound - self._points[0].value) / STEPS_ACROSS
        step = max(min(step, last, most), END_TOLERANCE * self._distance())
        value = at.value + self._direction * step
        if self._blocked is not None and self._direction * (value - self._blocked) >= 0:
            return 0.5 * (at.value + self._blocked)
        # A step that would end just before the bound goes all the way.
        room = self._direction * (self._bound - value)
        return value if room > BESIDE_BOUND * self._distance() else self._bound

    def _refined(self, outside: ProfilePoint) -> float:
        self._n_refined += 1
        pair = sorted((self._inside, outside), key=lambda x: x.value)
        if self._n_refined % 4 == 0:
            return 0.5 * (pair[0].value + pair[1].value)
        found = crossings(
            np.array([x.value for x in pair]),
            np.array([self._walk.delta(x) for x in pair]),
            np.array([x.slope for x in pair]),
            self._walk.threshold,
        )
        return found[0]

    def _take(self, point: ProfilePoint, start: Array) -> None:
        # Beside the feasibility boundary slopes say nothing of the next fit.
        is_smooth = self._walk.is_settled(point) and self._walk.is_settled(self._inside)
        mismatch = self._mismatch(point, start) if is_smooth else 0.0
        limit = MISMATCH * self._walk.threshold
        if mismatch > limit and self._n_retries < MOST_RETRIES and self._outside is None:
            self._n_retries += 1
            self._blocked = point.value
            return
        if self._outside is None:
            self._n_retries = 0
        if mismatch < -limit:
            # Walk back from a point that jumped down, and replace points that lie above this path.
            last, other = point, None
            for k in range(len(self._points) - 1, 0, -1):
                old = self._points[k]
                begin = self._walk.start(old.value, last, other)
                refitted = self._walk.solve(
                    old.value, begin, tolerance=ON_CURVE * self._walk.threshold
                )
                gain = old.evaluation.deviance - refitted.evaluation.deviance
                if not refitted.is_on_target or gain < ON_CURVE * self._walk.threshold:
                    break
                self._points[k] = self._walk.point(refitted)
                last, other = self._points[k], last
        self._accept(point)
        is_beyond = self._blocked is not None and (
            self._direction * (self._inside.value - self._blocked) > 0
        )
        if not self._is_gap or is_beyond:
            self._blocked, self._is_gap = None, False

    def _accept(self, point: ProfilePoint) -> None:
        self._points.append(point)
        if self._walk.delta(point) >= self._walk.threshold:
            self._outside = point
        else:
            self._inside = point

    def _mismatch(self, point: ProfilePoint, start: Array) -> float:
        """Excess of a point over its prediction from the slopes."""
        at = self._inside
        moved = point.evaluation.jacobian @ (point.evaluation.theta - start)
        if float(moved @ moved) < JUMP * self._walk.threshold:
            return 0.0
        step = point.value - at.value
        expected = 0.5 * step * (at.slope + point.slope)
        return point.evaluation.deviance - at.evaluation.deviance - expected

    # The end of the side.

    def _ended(self) -> Side | None:
        at, outside = self._inside, self._outside
        if at is not self._points[0] and self._is_known(at):
            return self._closed(at, at.value, 0.0)
        # From a value a rounding error before the bound no step leads to it.
        if abs(self._bound - at.value) <= ROUNDING * abs(self._bound) < np.inf:
            return self._at_bound()
        if outside is not None and self._is_excluded_by_feasibility(outside):
            return self._open(SideStatus.OPEN_AT_FEASIBILITY)
        for point in (outside, at):
            end = None if point is None else self._extrapolated_end(point)
            if point is not None and end is not None:
                missing = abs(self._walk.delta(point) - self._walk.threshold)
                slope = max(abs(point.slope), 1e-300)
                left = SLOPE_ERROR * missing + LEFT * AT_END * self._walk.threshold
                return self._closed(point, end, float(left / slope))
        if outside is not None:
            width = abs(outside.value - at.value)
            if width <= END_TOLERANCE * self._distance():
                return self._closed(at, at.value, width)
            if self._blocked is not None:
                room = abs(outside.value - self._blocked)
                if room <= GAP_TOLERANCE * self._distance():
                    return self._closed(outside, outside.value, width)
        elif self._blocked is not None:
            width = abs(self._blocked - at.value)
            if width <= GAP_TOLERANCE * self._distance():
                failed, ended = SideStatus.FAILED, SideStatus.OPEN_AT_FEASIBILITY
                return self._open(ended if self._is_gap else failed)
        is_far = not np.isfinite(self._bound) and self._distance() > FAR * self._unit
        if is_far and self._is_flat():
            return self._open(SideStatus.OPEN_FLAT)
        return None

    def _extrapolated_end(self, point: ProfilePoint) -> float | None:
        """Where the slope of a point leads to the end; None from afar or past the bound."""
        is_tight = point.left <= AT_END * self._walk.threshold
        is_close = abs(self._z(point) - self._root) <= CLOSE * self._root
        if not is_tight or not is_close or self._direction * point.slope <= 0:
            return None
        end = point.value + (self._walk.threshold - self._walk.delta(point)) / point.slope
        return end if self._direction * (self._bound - end) > 0 else None

    def _is_excluded_by_feasibility(self, point: ProfilePoint) -> bool:
        """Whether a fit is excluded only because the way to a better one has no prediction."""
        remaining_rise = self._walk.delta(point) - point.predicted_reduction
        is_excluded = remaining_rise >= ENOUGH * self._walk.threshold
        return not is_excluded and not self._walk.is_settled(point)

    def _at_bound(self) -> Side:
        return self._open(SideStatus.OPEN_FLAT if self._is_flat() else SideStatus.OPEN_AT_BOUND)

    def _is_flat(self) -> bool:
        at = self._inside
        distance = abs(at.value - self._points[0].value)
        # Right beside an optimum every deviance is flat.
        if distance < self._unit:
            return False
        return self._direction * at.slope * distance <= FLAT * self._walk.threshold

    def _z(self, point: ProfilePoint) -> float:
        return float(np.sqrt(max(self._walk.delta(point), 0.0)))

    def _distance(self) -> float:
        return max(abs(self._inside.value - self._points[0].value), self._unit)

    def _closed(self, point: ProfilePoint, end: float, error: float) -> Side:
        return self._side(SideStatus.CLOSED, point, end, error)

    def _open(self, status: SideStatus) -> Side:
        return self._side(status, self._inside, None, np.nan)

    def _side(
        self, status: SideStatus, point: ProfilePoint, end: float | None, error: float
    ) -> Side:
        parameters = self._walk.evaluator.parameters
        theta = point.evaluation.theta
        on_bound = (theta <= parameters.lower) | (theta >= parameters.upper)
        names = np.array(parameters.names)[on_bound].tolist()
        return Side(
            status=status,
            end=end,
            error=error,
            reached=point.value,
            max_deviance=max(self._walk.delta(x) for x in self._points),
            at_bounds=tuple(x for x in names if x != self._walk.quantity.name),
            made_by=OPEN_ENDS.get(status),
        )
