"""One side of a profile: constrained fits outward from an optimum until the set ends."""

from dataclasses import dataclass

import numpy as np

from identknee.calibrate.constrained import Constrained
from identknee.identify.profile.hermite import crossings
from identknee.identify.profile.result import Side, SideStatus
from identknee.identify.profile.walk import Point, Walk, step_to
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

POINTS_PER_SIDE = 5
MOST_POINTS = 80
LONGER = 2.5
# A side of the box is crossed in at least so many steps, lest one jumps over what stands there.
STEPS_ACROSS = 6
# Of the deviance, as parts of the threshold: what a fit on the curve and at an end may leave, and
# from which height on the next fit is to be the end.
ON_CURVE, AT_END, NEAR_END = 1e-3, 2e-4, 0.9
# Of what a fit promises to have left at most: beside a kink it is more than the derivatives say.
LEFT = 3.0
# Of the signed root at the threshold: from how near the slope leads to the end. A slope beside a
# kink is right to a part of itself.
CLOSE, SLOPE_ERROR = 2e-3, 0.1
# Of the distance to the optimum.
END_TOLERANCE = 1e-4
GAP_TOLERANCE = 3e-4
BESIDE_BOUND = 1e-3
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
MOST_DETOURS = 6
# Of the threshold: what a fit stopped at the boundary must promise to leave if its value is to
# count as excluded.
ENOUGH = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """One side walked.

    Attributes
    ----------
    points
        In the order found, the origin first.
    side
        How it ended.
    """

    points: tuple[Point, ...]
    side: Side


def march(walk: Walk, origin: Point, direction: int) -> Leg:
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
        The quantity and the threshold.
    origin
        Where to begin.
    direction
        1 for growing values, -1 for falling ones.
    """
    return _March(walk, origin, direction).run()


class _March:
    """The state of one walk outward."""

    def __init__(self, walk: Walk, origin: Point, direction: int) -> None:
        self._walk = walk
        self._direction = direction
        self._points = [origin]
        self._inside = origin
        self._outside: Point | None = None
        self._blocked: float | None = None
        self._is_gap = False
        self._bound = walk.limits[1 if direction > 0 else 0]
        self._root = float(np.sqrt(walk.threshold))
        self._n_refined = self._n_retries = self._n_detours = 0
        self._unit = self._first_step(origin)

    def run(self) -> Leg:
        for _ in range(MOST_POINTS):
            side = self._ended()
            if side is None:
                side = self._go_on()
            if side is not None:
                return Leg(points=tuple(self._points), side=side)
        return Leg(points=tuple(self._points), side=self._open(SideStatus.OPEN_BUDGET))

    def _first_step(self, origin: Point) -> float:
        rise = self._walk.threshold / POINTS_PER_SIDE**2
        step = step_to(rise, 0.0, origin.curvature)
        low, high = self._walk.limits
        if step < high - low:
            return step
        room = abs(self._bound - origin.value)
        return room / STEPS_ACROSS if np.isfinite(room) else max(abs(origin.value), 1.0)

    # Where to go.

    def _go_on(self) -> Side | None:
        value = self._next_value()
        start = self._walk.start(value, self._inside, self._behind())
        is_near_end = self._outside is not None or (
            self._walk.delta(self._inside) > NEAR_END * self._walk.threshold
        )
        tolerance = self._walk.threshold * (AT_END if is_near_end else ON_CURVE)
        solved = self._solved(value, start, tolerance)
        if solved.outcome is Outcome.BUDGET:
            return self._open(SideStatus.OPEN_BUDGET)
        if not np.isfinite(solved.evaluation.deviance):
            return self._meet_gap(value, tolerance)
        if not solved.is_on_target:
            return self._missed(value, solved, tolerance)
        self._take(self._walk.point(solved), start)
        return None

    def _solved(self, value: float, start: Array, tolerance: float) -> Constrained:
        """The constrained fit at a value, from other points too where the model ends on the way."""
        walk, inside = self._walk, self._inside.evaluation
        solved = walk.solve(value, start, tolerance=tolerance)
        if solved.outcome is Outcome.START_FAILED:
            solved = walk.solve(value, inside.theta, tolerance=tolerance)
        if self._n_detours == MOST_DETOURS or not self._is_cut_off(solved):
            return solved
        self._n_detours += 1
        around = walk.solve_around(value, inside, tolerance=tolerance)
        if around is None or (
            solved.is_on_target and solved.evaluation.deviance <= around.evaluation.deviance
        ):
            return solved
        return around

    def _is_cut_off(self, solved: Constrained) -> bool:
        """Whether the feasibility boundary kept a fit from being made or from going lower."""
        if solved.outcome in {Outcome.START_FAILED, Outcome.CLIFF} and not solved.is_on_target:
            return True
        return solved.is_on_target and not self._walk.is_settled(self._walk.point(solved))

    def _meet_gap(self, value: float, tolerance: float) -> Side | None:
        """Go on beyond values without prediction where there are others; else come nearer."""
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

    def _behind(self) -> Point | None:
        """The accepted point before the last, or the one beyond the end."""
        if self._outside is not None:
            return self._outside
        return self._points[-2] if len(self._points) > 1 else None

    def _next_value(self) -> float:
        if self._outside is not None:
            if self._blocked is not None:
                return 0.5 * (self._blocked + self._outside.value)
            return self._refined(self._outside)
        at = self._inside
        root = self._z(at)
        spacing = self._root / POINTS_PER_SIDE
        goal = self._root if root + 1.4 * spacing > self._root else root + spacing
        slope = self._direction * at.slope
        step = step_to(goal**2 - self._walk.delta(at), slope, at.curvature)
        if not self._walk.is_settled(at):
            # The slope is that of the boundary.
            step = max(step, self._unit)
        value = at.value + self._direction * self._limited(step)
        if self._blocked is not None and self._direction * (value - self._blocked) >= 0:
            return 0.5 * (at.value + self._blocked)
        # A step that would end just before the bound goes all the way.
        room = self._direction * (self._bound - value)
        return value if room > BESIDE_BOUND * self._distance() else self._bound

    def _limited(self, step: float) -> float:
        last = self._unit
        if len(self._points) > 1:
            last = max(LONGER * abs(self._points[-1].value - self._points[-2].value), self._unit)
        room = abs(self._bound - self._points[0].value) / STEPS_ACROSS
        return max(min(step, last, room), END_TOLERANCE * self._distance())

    def _refined(self, outside: Point) -> float:
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

    # What came back.

    def _missed(self, value: float, solved: Constrained, tolerance: float) -> Side | None:
        """Take a fit that is not on target: the end of the range, a gap or a failure."""
        if solved.outcome is Outcome.MINIMUM:
            point = self._walk.point(solved)
            self._bound = point.value
            if self._direction * (point.value - self._inside.value) > 0:
                self._accept(point)
            else:
                return self._at_bound()
            return None
        if solved.outcome is Outcome.CLIFF:
            return self._meet_gap(value, tolerance)
        self._blocked = value
        return None

    def _take(self, point: Point, start: Array) -> None:
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
            self._repair(point)
        self._accept(point)
        is_beyond = self._blocked is not None and (
            self._direction * (self._inside.value - self._blocked) > 0
        )
        if not self._is_gap or is_beyond:
            self._blocked, self._is_gap = None, False

    def _accept(self, point: Point) -> None:
        self._points.append(point)
        if self._walk.delta(point) >= self._walk.threshold:
            self._outside = point
        else:
            self._inside = point

    def _mismatch(self, point: Point, start: Array) -> float:
        """How much higher a point is than the slopes say, where it is not where it was expected."""
        at = self._inside
        moved = point.evaluation.jacobian @ (point.evaluation.theta - start)
        if float(moved @ moved) < JUMP * self._walk.threshold:
            return 0.0
        step = point.value - at.value
        expected = 0.5 * step * (at.slope + point.slope)
        return point.evaluation.deviance - at.evaluation.deviance - expected

    def _repair(self, point: Point) -> None:
        """Walk back from a point that jumped down, and replace points that lie above this path."""
        last, other = point, None
        for k in range(len(self._points) - 1, 0, -1):
            old = self._points[k]
            start = self._walk.start(old.value, last, other)
            solved = self._walk.solve(old.value, start, tolerance=ON_CURVE * self._walk.threshold)
            gain = old.evaluation.deviance - solved.evaluation.deviance
            if not solved.is_on_target or gain < ON_CURVE * self._walk.threshold:
                break
            self._points[k] = self._walk.point(solved)
            last, other = self._points[k], last

    # How it ended.

    def _ended(self) -> Side | None:
        at, outside = self._inside, self._outside
        if at.value == self._bound:
            return self._at_bound()
        if outside is not None and self._is_raised_by_boundary(outside):
            return self._open(SideStatus.OPEN_AT_FEASIBILITY)
        for point in (outside, at):
            end = None if point is None else self._end_seen_from(point)
            if point is not None and end is not None:
                return self._closed(point, end, self._error(point))
        if outside is not None:
            width = abs(outside.value - at.value)
            if width <= END_TOLERANCE * self._distance():
                return self._closed(at, at.value, width)
        elif self._blocked is not None:
            width = abs(self._blocked - at.value)
            if width <= GAP_TOLERANCE * self._distance():
                failed, ended = SideStatus.FAILED, SideStatus.OPEN_AT_FEASIBILITY
                return self._open(ended if self._is_gap else failed)
        if not np.isfinite(self._bound) and self._is_flat_far_out():
            return self._open(SideStatus.OPEN_FLAT)
        return None

    def _end_seen_from(self, point: Point) -> float | None:
        """Where the slope of a point leads to the end; None from afar or past the bound."""
        is_tight = point.left <= AT_END * self._walk.threshold
        is_close = abs(self._z(point) - self._root) <= CLOSE * self._root
        if not is_tight or not is_close or self._direction * point.slope <= 0:
            return None
        end = point.value + (self._walk.threshold - self._walk.delta(point)) / point.slope
        return end if self._direction * (self._bound - end) > 0 else None

    def _is_raised_by_boundary(self, point: Point) -> bool:
        """Whether a fit is excluded only because the way to a better one has no prediction."""
        promised = self._walk.delta(point) - point.promise
        is_excluded = promised >= ENOUGH * self._walk.threshold
        return not is_excluded and not self._walk.is_settled(point)

    def _at_bound(self) -> Side:
        flat = self._is_flat()
        return self._open(SideStatus.OPEN_FLAT if flat else SideStatus.OPEN_AT_BOUND)

    def _is_flat(self) -> bool:
        at = self._inside
        distance = abs(at.value - self._points[0].value)
        # Right beside an optimum every deviance is flat.
        if distance < self._unit:
            return False
        return self._direction * at.slope * distance <= FLAT * self._walk.threshold

    def _is_flat_far_out(self) -> bool:
        return self._distance() > FAR * self._unit and self._is_flat()

    def _z(self, point: Point) -> float:
        return float(np.sqrt(max(self._walk.delta(point), 0.0)))

    def _distance(self) -> float:
        return max(abs(self._inside.value - self._points[0].value), self._unit)

    def _error(self, point: Point) -> float:
        """What the way to the end and the fit may be off, as a length of the value."""
        missing = abs(self._walk.delta(point) - self._walk.threshold)
        slope = max(abs(point.slope), 1e-300)
        return float((SLOPE_ERROR * missing + LEFT * AT_END * self._walk.threshold) / slope)

    def _closed(self, point: Point, end: float, error: float) -> Side:
        return self._side(SideStatus.CLOSED, point, end, error)

    def _open(self, status: SideStatus) -> Side:
        return self._side(status, self._inside, None, np.nan)

    def _side(self, status: SideStatus, point: Point, end: float | None, error: float) -> Side:
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
        )
