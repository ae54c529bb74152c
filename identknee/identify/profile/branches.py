"""The paths of a profile: from the best fit, from other optima, and from beyond their ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from identknee.calibrate.bounded_least_squares import IsEnough, minimise
from identknee.calibrate.problem import (
    EIGENVALUE_TOLERANCE,
    Evaluation,
    ParameterQuantity,
    typical_steps,
)
from identknee.identify.profile.result import Side, SideStatus, cubic
from identknee.identify.profile.walk import (
    AT_END,
    JUMP,
    ON_CURVE,
    ProfileContext,
    ProfilePoint,
    SideWalk,
    march,
)
from identknee.runs.declare import Array

MOST_BRANCHES = 12
# Steps after which an exploratory fit must be near an optimum.
EXPLORATORY_STEPS = 8
# Steps of a fit that returns from beyond a lost path.
RETURN_STEPS = 24
# Of the threshold: the error of an exploratory fit and of the derivatives at its end, and how
# near a fit must have come to be followed.
GLANCE_TOLERANCE = 2e-2
NEAR = 10.0
# In widths of the set: how far out to look where there is no bound.
WIDTHS = 1.0
# In widths of the set: a gap narrower than this is not looked into.
NARROW = 0.05
# How often an end is looked at again, and from how many other optima.
MOST_LOOKS, MOST_STARTS = 3, 4
# How far beyond an end to go and come back, in distances to the optimum.
OUTSIDE = 1.0
# Share of the distance to the ends of the confidence set over which a constant is tried.
ALMOST = 0.9

Region = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Branch:
    """The profile from one local optimum, downward and upward."""

    lower: SideWalk
    upper: SideWalk

    @property
    def origin(self) -> ProfilePoint:
        """The optimum."""
        return self.lower.points[0]

    @property
    def points(self) -> list[ProfilePoint]:
        """All points from low to high values."""
        return sorted([*self.lower.points, *self.upper.points[1:]], key=lambda x: x.value)

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper end of the confidence set, infinite where open."""
        low, high = self.lower.side.end, self.upper.side.end
        return (-np.inf if low is None else low), (np.inf if high is None else high)

    def nearest(self, value: float) -> ProfilePoint:
        """The point whose value is nearest."""
        return min(self.points, key=lambda x: abs(x.value - value))


def walk_branch(walk: ProfileContext, origin: ProfilePoint, known: Sequence[Branch] = ()) -> Branch:
    """The profile from an optimum downward and upward, as far as it is not that of known branches.

    A side ends where it has come to the path of a known branch. Beside nuisances, where paths are
    long, it also ends where a known branch is lower: what it may find farther out is looked for
    from the end of the set.
    """
    is_known = partial(_is_covered, walk, known, is_below_enough=_is_long(walk))
    lower, upper = (march(walk, origin, x, is_known=is_known) for x in (-1, 1))
    return Branch(lower=lower, upper=upper)


def _branch_onward(
    walk: ProfileContext, origin: ProfilePoint, known: Sequence[Branch], direction: int
) -> Branch:
    """The profile onward from a point at the end of the set.

    Its other side ends where a known branch is lower; where paths are long, it is not walked.
    """
    onward = march(walk, origin, direction, is_known=partial(_is_covered, walk, known))
    back = _known_leg(origin)
    if not _is_long(walk):
        is_known = partial(_is_covered, walk, known, is_below_enough=True)
        back = march(walk, origin, -direction, is_known=is_known)
    return Branch(lower=back, upper=onward) if direction > 0 else Branch(lower=onward, upper=back)


def _is_long(walk: ProfileContext) -> bool:
    return not walk.evaluator.parameters.is_of_interest.all()


def _known_leg(origin: ProfilePoint) -> SideWalk:
    """A side that is not walked: its end is the point that it would begin at."""
    side = Side(
        status=SideStatus.CLOSED,
        end=origin.value,
        error=0.0,
        reached=origin.value,
        max_deviance=0.0,
        at_bounds=(),
    )
    return SideWalk(points=(origin,), side=side)


def _is_covered(
    walk: ProfileContext,
    known: Sequence[Branch],
    point: ProfilePoint,
    *,
    is_below_enough: bool = False,
) -> bool:
    """Whether a known branch goes through a point, or below it where that is enough."""
    height = walk.delta(point) + ON_CURVE * walk.threshold
    lower = [x for x in known if height_at(walk, x, point.value) <= height]
    return bool(lower) and (is_below_enough or _is_known(walk, lower, point))


def constant_branches(walk: ProfileContext, origin: ProfilePoint) -> list[Branch]:
    """The branches of a quantity that is locally constant, such as a slack line's force.

    Its set begins as that one value. Where it is another one at an end of the confidence set of a
    parameter, by the covariance at the optimum, the fit there with the largest and the smallest
    value begin branches of their own.
    """
    leg = _known_leg(origin)
    branches = [Branch(lower=leg, upper=leg)]
    # Theta near each end of each parameter's confidence set, the others adjusted.
    parameters = walk.evaluator.parameters
    at = origin.evaluation
    scales = typical_steps(parameters)
    inverse = np.linalg.pinv(at.information * np.outer(scales, scales), rcond=EIGENVALUE_TOLERANCE)
    covariance = inverse * np.outer(scales, scales)
    sd = np.sqrt(np.diag(covariance))
    known = sd > 0
    moves = ALMOST * np.sqrt(walk.threshold) * (covariance[:, known] / sd[known]).T
    corners = [
        np.clip(at.theta + sign * move, parameters.lower, parameters.upper)
        for move in moves
        for sign in (-1.0, 1.0)
    ]
    found = [(*walk.quantity.evaluate(theta), theta) for theta in corners]
    found = [x for x in found if np.isfinite(x[0]) and x[0] != origin.value and x[1].any()]
    for value, _, theta in sorted(found, key=lambda x: x[0])[:: max(len(found) - 1, 1)]:
        solved = walk.solve(value, theta, tolerance=GLANCE_TOLERANCE * walk.threshold)
        if solved.is_on_target and solved.evaluation.deviance - walk.lowest < walk.threshold:
            branches.append(walk_branch(walk, walk.point(solved)))
    return branches


def find_branches(walk: ProfileContext, main: Branch, starts: Sequence[Array]) -> list[Branch]:
    """The branches of the optimum and of other local optima found.

    Fits without a constraint start from the middle of what lies beyond each closed end, and from
    each of `starts`. Where one ends at a likely optimum that is not on a path walked before, its
    own branch is walked, and the gaps that it leaves are looked into in their turn. Paths that lead
    to no optimum of their own are looked for by coming back to each end of the optimum's branch
    from outside. Beside nuisances the ends of the whole set are looked at again.
    """
    branches = [main]
    regions = _beside(main, walk.limits)
    while regions and len(branches) < MOST_BRANCHES:
        region = regions.pop(0)
        # The optimum's theta moved into a region, shape ``(n,)``; None if that is too narrow.
        low, high = main.limits
        reach = [x for x in (low, high) if np.isfinite(x)] + [main.origin.value]
        width = max(reach) - min(reach)
        if region[1] - region[0] < NARROW * width:
            start = None
        else:
            if np.isinf(region[0]):
                value = region[1] - WIDTHS * width
            elif np.isinf(region[1]):
                value = region[0] + WIDTHS * width
            else:
                value = 0.5 * (region[0] + region[1])
            theta = np.array(main.origin.evaluation.theta)
            if isinstance(walk.quantity, ParameterQuantity):
                theta[walk.quantity.index] = value
                start = theta
            else:
                tolerance = GLANCE_TOLERANCE * walk.threshold
                solved = walk.solve(value, theta, tolerance=tolerance, most_steps=EXPLORATORY_STEPS)
                start = solved.evaluation.theta if solved.evaluation.is_finite else None
        branch = None if start is None else _branch_from(walk, branches, start)
        if branch is not None:
            branches.append(branch)
            regions += _beside(branch, region)
    for leg, direction in ((main.lower, -1), (main.upper, 1)):
        branch = _branch_beyond_end(walk, branches, leg, direction)
        if branch is not None:
            branches.append(branch)
    for start in starts:
        branch = _branch_from(walk, branches, start)
        if branch is not None and len(branches) < MOST_BRANCHES:
            branches.append(branch)
    for direction in (-1, 1) if _is_long(walk) else ():
        for _ in range(MOST_LOOKS):
            branch = _branch_at_end(walk, branches, starts, direction)
            if branch is None:
                break
            branches.append(branch)
    return branches


def _branch_at_end(
    walk: ProfileContext, branches: Sequence[Branch], starts: Sequence[Array], direction: int
) -> Branch | None:
    """A branch that is lower where the set ends; None if none is found, or the set is open there.

    The fit at the end is made again from points farther back on its path, and from the first of
    the `starts`.
    """
    legs = [x.upper if direction > 0 else x.lower for x in branches]
    ends = [x.side.end for x in legs if x.side.end is not None]
    if len(ends) < len(legs):
        return None
    best = int(np.argmax(direction * np.array(ends)))
    end = ends[best]
    points = sorted(branches[best].points, key=lambda x: abs(x.value - end))
    thetas = [x.evaluation.theta for x in points[2:5:2]]
    for theta in (*thetas, *starts[:MOST_STARTS]):
        again = _rough_fit(
            walk,
            end,
            theta,
            near=theta,
            most_steps=RETURN_STEPS,
            is_enough=partial(_joins, walk, [points[0]]),
        )
        if again is not None and walk.delta(again) < (1.0 - GLANCE_TOLERANCE) * walk.threshold:
            return _branch_onward(walk, again, branches, direction)
    return None


def _beside(branch: Branch, region: Region) -> list[Region]:
    """The parts of a range of values below and above a branch."""
    low, high = branch.limits
    below, above = (region[0], low), (high, region[1])
    return [x for x in (below, above) if x[0] < x[1] and not np.isinf(low if x is below else high)]


def _branch_beyond_end(
    walk: ProfileContext, known: Sequence[Branch], leg: SideWalk, direction: int
) -> Branch | None:
    """The branch met by going on beyond a closed end and coming back; None if it is the same one.

    Where the path folds, the fits beyond its end lie on another part of it, which may be lower at
    the end too although no fit without a constraint stays there.
    """
    end = leg.side.end
    if end is None:
        return None
    last = min(leg.points, key=lambda x: abs(x.value - end))
    value = end + direction * OUTSIDE * abs(end - leg.points[0].value)
    value = float(np.clip(value, *walk.limits))
    if value == end:
        return None
    far = _rough_fit(walk, value, walk.start(value, last, None))
    if far is None:
        return None
    if walk.delta(far) < walk.threshold:
        return walk_branch(walk, far, known)
    expected = walk.start(end, far, None)
    moved = last.evaluation.jacobian @ (expected - last.evaluation.theta)
    if float(moved @ moved) < JUMP * walk.threshold:
        return None
    # At a fold the two parts of the path lie on different sides of the end.
    parameters = walk.evaluator.parameters
    opposite = np.clip(2.0 * last.evaluation.theta - expected, parameters.lower, parameters.upper)
    for start in (expected, opposite):
        back = _rough_fit(
            walk,
            end,
            start,
            most_steps=RETURN_STEPS,
            is_enough=partial(_joins, walk, [last]),
        )
        if back is not None and walk.delta(back) < (1.0 - GLANCE_TOLERANCE) * walk.threshold:
            return _branch_onward(walk, back, known, direction)
    return None


def _rough_fit(
    walk: ProfileContext,
    value: float,
    start: Array,
    *,
    most_steps: int = EXPLORATORY_STEPS,
    is_enough: IsEnough | None = None,
    near: Array | None = None,
) -> ProfilePoint | None:
    """A rough constrained fit at a value; None if it failed or stopped early."""
    solved = walk.solve(
        value,
        start,
        tolerance=GLANCE_TOLERANCE * walk.threshold,
        most_steps=most_steps,
        is_enough=is_enough,
        near=near,
    )
    is_there = solved.evaluation.is_finite and solved.is_on_target
    return walk.point(solved) if is_there else None


def _branch_from(walk: ProfileContext, branches: Sequence[Branch], start: Array) -> Branch | None:
    """The branch of the optimum that `start` leads to, if that is likely and not known."""
    is_known = partial(_joins, walk, [x.origin for x in branches])
    rough = minimise(
        walk.evaluator,
        start,
        tolerance=GLANCE_TOLERANCE * walk.threshold,
        most_steps=EXPLORATORY_STEPS,
        is_enough=is_known,
    )
    is_far = rough.evaluation.deviance - walk.lowest > NEAR * walk.threshold
    if is_far or is_known(rough.evaluation):
        return None
    point = _point(walk, rough.evaluation.theta)
    if point is None or _is_known(walk, branches, point):
        return None
    found = minimise(walk.evaluator, rough.evaluation.theta, tolerance=AT_END * walk.threshold)
    point = _point(walk, found.evaluation.theta)
    if point is None or walk.delta(point) >= walk.threshold or _is_known(walk, branches, point):
        return None
    if _is_covered(walk, branches, point, is_below_enough=_is_long(walk)):
        return None
    return walk_branch(walk, point, branches)


def _joins(walk: ProfileContext, ends: Sequence[ProfilePoint], at: Evaluation) -> bool:
    """Whether `at` is close to a known fit that ended as low.

    It would where the residuals change between both as the derivatives at either say: the next step
    leads there.
    """
    for end in ends:
        known = end.evaluation
        way = known.theta - at.theta
        change = known.residuals - at.residuals
        missed = (change - at.jacobian @ way, change - known.jacobian @ way)
        if max(float(x @ x) for x in missed) < GLANCE_TOLERANCE * walk.threshold:
            return True
    return False


def _point(walk: ProfileContext, theta: Array) -> ProfilePoint | None:
    """The point of a profile at theta, no fit being made; None where there is no prediction."""
    value, _ = walk.quantity.evaluate(theta)
    if not np.isfinite(value):
        return None
    solved = walk.solve(value, theta, tolerance=np.inf)
    return walk.point(solved) if solved.evaluation.is_finite else None


def _is_known(walk: ProfileContext, branches: Sequence[Branch], point: ProfilePoint) -> bool:
    """Whether a point lies on the path of one of the branches, or near its optimum."""
    for branch in branches:
        low, high = branch.limits
        if not low <= point.value <= high:
            continue
        expected = walk.start(point.value, branch.nearest(point.value), None)
        moved = point.evaluation.jacobian @ (point.evaluation.theta - expected)
        if float(moved @ moved) < JUMP * walk.threshold:
            return True
    return False


def height_at(walk: ProfileContext, branch: Branch, value: float) -> float:
    """Rise of the deviance of a branch at a value; infinite outside its range."""
    for left, right in pairwise(branch.points):
        if left.value <= value <= right.value and left.value < right.value:
            return cubic(
                value,
                (left.value, walk.delta(left), left.slope),
                (right.value, walk.delta(right), right.slope),
            )
    return np.inf
