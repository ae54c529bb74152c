"""Looking for other valleys that a profile walked from one optimum would miss."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from identknee.calibrate.constrained import IsEnough, minimise
from identknee.calibrate.evaluation import Evaluation
from identknee.calibrate.quantity import ParameterQuantity
from identknee.calibrate.scales import typical_steps
from identknee.calibrate.tolerances import EIGENVALUE_TOLERANCE
from identknee.identify.profile.march import AT_END, JUMP, Leg, march
from identknee.identify.profile.result import Side, SideStatus
from identknee.identify.profile.walk import Point, Walk
from identknee.runs.arrays import Array

MOST_BRANCHES = 12
# A fit that looks around takes so many steps before it must have come near.
GLANCE_STEPS = 8
# One that comes back from where the path was lost may take more.
RETURN_STEPS = 24
# Of the threshold: what a glance may leave or the derivatives at its simulation be off, and how
# near a fit must have come to be followed.
GLANCE_TOLERANCE = 2e-2
NEAR = 10.0
# In widths of the set: how far out to look where there is no bound.
WIDTHS = 1.0
# In widths of the set: a gap narrower than this is not looked into.
NARROW = 0.05
# How far beyond an end to go and come back, in distances to the optimum.
OUTSIDE = 1.0
# Share of the distance to the ends of the confidence set over which a constant is tried.
ALMOST = 0.9

Region = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Branch:
    """The profile walked from one local optimum, downward and upward."""

    lower: Leg
    upper: Leg

    @property
    def origin(self) -> Point:
        """The optimum."""
        return self.lower.points[0]

    @property
    def points(self) -> list[Point]:
        """All points from low to high values."""
        both = [*self.lower.points, *self.upper.points[1:]]
        return sorted(both, key=lambda x: x.value)

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper end of the confidence set, infinite where open."""
        low, high = self.lower.side.end, self.upper.side.end
        return (-np.inf if low is None else low), (np.inf if high is None else high)

    def nearest(self, value: float) -> Point:
        """The point whose value is nearest."""
        return min(self.points, key=lambda x: abs(x.value - value))


def walk_branch(walk: Walk, origin: Point) -> Branch:
    """The profile from an optimum downward and upward."""
    return Branch(lower=march(walk, origin, -1), upper=march(walk, origin, 1))


def branches_of_a_constant(walk: Walk, origin: Point) -> list[Branch]:
    """The branches of a quantity that does not change around the optimum, as a slack line's force.

    Its set begins as that one value. Where it is another one at an end of the confidence set of a
    parameter, by the covariance at the optimum, the fit there with the largest and the smallest
    value begin branches of their own.

    Parameters
    ----------
    walk
        The quantity and the threshold.
    origin
        The optimum.
    """
    side = Side(
        status=SideStatus.CLOSED,
        end=origin.value,
        error=0.0,
        reached=origin.value,
        max_deviance=0.0,
        at_bounds=(),
    )
    leg = Leg(points=(origin,), side=side)
    branches = [Branch(lower=leg, upper=leg)]
    found = [(*walk.quantity.evaluate(theta), theta) for theta in _likely_ends(walk, origin)]
    found = [x for x in found if np.isfinite(x[0]) and x[0] != origin.value and x[1].any()]
    for value, _, theta in sorted(found, key=lambda x: x[0])[:: max(len(found) - 1, 1)]:
        solved = walk.solve(value, theta, tolerance=GLANCE_TOLERANCE * walk.threshold)
        if solved.is_on_target and solved.evaluation.deviance - walk.lowest < walk.threshold:
            branches.append(walk_branch(walk, walk.point(solved)))
    return branches


def _likely_ends(walk: Walk, origin: Point) -> list[Array]:
    """Theta with each parameter almost at an end of its confidence set, the others following."""
    parameters = walk.evaluator.parameters
    at = origin.evaluation
    scales = typical_steps(parameters)
    inverse = np.linalg.pinv(at.information * np.outer(scales, scales), rcond=EIGENVALUE_TOLERANCE)
    covariance = inverse * np.outer(scales, scales)
    sd = np.sqrt(np.diag(covariance))
    known = sd > 0
    moves = ALMOST * np.sqrt(walk.threshold) * (covariance[:, known] / sd[known]).T
    return [
        np.clip(at.theta + sign * move, parameters.lower, parameters.upper)
        for move in moves
        for sign in (-1.0, 1.0)
    ]


def find_branches(walk: Walk, main: Branch, starts: Array) -> list[Branch]:
    """The optimum's branch and those of other likely optima, as far as found.

    Fits without a constraint start from the middle of what lies beyond each closed end, and from
    each of `starts`. Where one ends at a likely optimum that is not on a path walked before, its
    own branch is walked, and the gaps that it leaves are looked into in their turn. Paths that lead
    to no optimum of their own are looked for by coming back to each end of the optimum's branch
    from outside.

    Parameters
    ----------
    walk
        The quantity and the threshold.
    main
        The optimum's branch.
    starts
        Where else to look for optima, shape ``(k, n)``.
    """
    branches = [main]
    regions = _beside(main, walk.limits)
    while regions and len(branches) < MOST_BRANCHES:
        region = regions.pop(0)
        start = _into(walk, main, region)
        branch = None if start is None else _branch_from(walk, branches, start)
        if branch is not None:
            branches.append(branch)
            regions += _beside(branch, region)
    for leg, direction in ((main.lower, -1), (main.upper, 1)):
        branch = _from_outside(walk, leg, direction)
        if branch is not None and not _is_known(walk, branches, branch.origin):
            branches.append(branch)
    for start in starts:
        branch = _branch_from(walk, branches, start)
        if branch is not None and len(branches) < MOST_BRANCHES:
            branches.append(branch)
    return branches


def _beside(branch: Branch, region: Region) -> list[Region]:
    """What a branch leaves of a region, below and above."""
    low, high = branch.limits
    below, above = (region[0], low), (high, region[1])
    return [x for x in (below, above) if x[0] < x[1] and not np.isinf(low if x is below else high)]


def _into(walk: Walk, main: Branch, region: Region) -> Array | None:
    """The optimum's theta moved into a region, shape ``(n,)``; None if that is too narrow."""
    low, high = main.limits
    reach = [x for x in (low, high) if np.isfinite(x)] + [main.origin.value]
    width = max(reach) - min(reach)
    if region[1] - region[0] < NARROW * width:
        return None
    if np.isinf(region[0]):
        value = region[1] - WIDTHS * width
    elif np.isinf(region[1]):
        value = region[0] + WIDTHS * width
    else:
        value = 0.5 * (region[0] + region[1])
    theta = np.array(main.origin.evaluation.theta)
    if isinstance(walk.quantity, ParameterQuantity):
        theta[walk.quantity.index] = value
        return theta
    tolerance = GLANCE_TOLERANCE * walk.threshold
    solved = walk.solve(value, theta, tolerance=tolerance, most_steps=GLANCE_STEPS)
    return solved.evaluation.theta if solved.evaluation.is_finite else None


def _from_outside(walk: Walk, leg: Leg, direction: int) -> Branch | None:
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
    far = _glance(walk, value, walk.start(value, last, None))
    if far is None:
        return None
    if walk.delta(far) < walk.threshold:
        return walk_branch(walk, far)
    expected = walk.start(end, far, None)
    moved = last.evaluation.jacobian @ (expected - last.evaluation.theta)
    if float(moved @ moved) < JUMP * walk.threshold:
        return None
    # At a fold the two parts of the path lie on different sides of the end.
    parameters = walk.evaluator.parameters
    opposite = np.clip(2.0 * last.evaluation.theta - expected, parameters.lower, parameters.upper)
    for start in (expected, opposite):
        back = _glance(
            walk,
            end,
            start,
            most_steps=RETURN_STEPS,
            is_enough=partial(_joins, walk, [last]),
        )
        if back is not None and walk.delta(back) < (1.0 - GLANCE_TOLERANCE) * walk.threshold:
            return walk_branch(walk, back)
    return None


def _glance(
    walk: Walk,
    value: float,
    start: Array,
    *,
    most_steps: int = GLANCE_STEPS,
    is_enough: IsEnough | None = None,
) -> Point | None:
    """A rough fit at a value, None where there is none or it saw enough on its way."""
    solved = walk.solve(
        value,
        start,
        tolerance=GLANCE_TOLERANCE * walk.threshold,
        most_steps=most_steps,
        is_enough=is_enough,
    )
    is_there = solved.evaluation.is_finite and solved.is_on_target
    return walk.point(solved) if is_there else None


def _branch_from(walk: Walk, branches: Sequence[Branch], start: Array) -> Branch | None:
    """The branch of the optimum that `start` leads to, if that is likely and not known."""
    is_known = partial(_joins, walk, [x.origin for x in branches])
    glance = minimise(
        walk.evaluator,
        start,
        tolerance=GLANCE_TOLERANCE * walk.threshold,
        most_steps=GLANCE_STEPS,
        is_enough=is_known,
    )
    is_far = glance.evaluation.deviance - walk.lowest > NEAR * walk.threshold
    if is_far or is_known(glance.evaluation):
        return None
    point = _point(walk, glance.evaluation.theta)
    if point is None or _is_known(walk, branches, point):
        return None
    found = minimise(walk.evaluator, glance.evaluation.theta, tolerance=AT_END * walk.threshold)
    walk.note(found.evaluation)
    point = _point(walk, found.evaluation.theta)
    if point is None or walk.delta(point) >= walk.threshold or _is_known(walk, branches, point):
        return None
    return walk_branch(walk, point)


def _joins(walk: Walk, ends: Sequence[Point], at: Evaluation) -> bool:
    """Whether a fit that comes to `at` would go on to one of the fits known.

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


def _point(walk: Walk, theta: Array) -> Point | None:
    """The point of a profile at theta, no fit being made; None where there is no prediction."""
    value, _ = walk.quantity.evaluate(theta)
    if not np.isfinite(value):
        return None
    solved = walk.solve(value, theta, tolerance=np.inf)
    return walk.point(solved) if solved.evaluation.is_finite else None


def _is_known(walk: Walk, branches: Sequence[Branch], point: Point) -> bool:
    """Whether a point lies on the path of one of the branches, or near its optimum."""
    for branch in branches:
        low, high = branch.limits
        if not low <= point.value <= high:
            continue
        near = branch.nearest(point.value)
        expected = walk.start(point.value, near, None)
        moved = point.evaluation.jacobian @ (point.evaluation.theta - expected)
        if float(moved @ moved) < JUMP * walk.threshold:
            return True
    return False
