"""What the walked branches of a profile say together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.stats

from identknee.calibrate.scales import conditional_sds
from identknee.calibrate.tolerances import UNSEEN_TOLERANCE
from identknee.identify.profile.hermite import cubic
from identknee.identify.profile.march import AT_END, FLAT
from identknee.identify.profile.result import Interval, Profile, ProfileVerdict, Side, SideStatus
from identknee.identify.profile.search import Branch
from identknee.identify.profile.walk import Point, Walk
from identknee.runs.arrays import Array

# Of the quantity's gradient: what may lie in directions that the data do not see.
UNSEEN = 1e-3
UNDECIDED = (SideStatus.OPEN_BUDGET, SideStatus.FAILED)


def assembled(
    walk: Walk,
    branches: Sequence[Branch],
    *,
    level: float,
    better_optimum: Array | None,
    n_restarts: int,
) -> Profile:
    """The profile that the branches make together: their lower envelope and their union.

    Parameters
    ----------
    walk
        The quantity and the threshold.
    branches
        That of the optimum first.
    level
        Confidence level that the threshold stands for.
    better_optimum, n_restarts
        The optimum, where it is not the one given, and how often the profile was started over.
    """
    origin = branches[0].origin
    intervals, sides = _union(branches)
    curve = _envelope(walk, branches)
    return Profile(
        name=walk.quantity.name,
        unit=walk.quantity.unit,
        level=level,
        threshold=walk.threshold,
        optimum=origin.evaluation.theta,
        optimum_value=origin.value,
        deviance=walk.lowest,
        values=np.array([x.value for x, _ in curve]),
        thetas=np.array([x.evaluation.theta for x, _ in curve]),
        deltas=np.array([walk.delta(x) for x, _ in curve]),
        slopes=curve_slopes(walk, [x for x, _ in curve]),
        branches=np.array([k for _, k in curve]),
        intervals=intervals,
        lower_side=sides[0],
        upper_side=sides[1],
        verdict=_verdict(walk, origin, sides, intervals),
        practical_level=min(_level(x, level, walk.threshold) for x in sides),
        n_simulations=walk.evaluator.n_simulations,
        better_optimum=better_optimum,
        n_restarts=n_restarts,
    )


def _union(branches: Sequence[Branch]) -> tuple[tuple[Interval, ...], tuple[Side, Side]]:
    """The separate intervals of all branches together, and the outermost sides.

    Two are separate where the data exclude what lies between. Where only the model ends between
    them, nothing does, and they are one.
    """
    reaches = [_Reach.of(x) for x in branches]
    merged: list[_Reach] = []
    for reach in sorted(reaches, key=lambda x: (x.low, x.high)):
        if merged and merged[-1].goes_on_to(reach):
            merged[-1] = merged[-1].joined(reach)
        else:
            merged.append(reach)
    intervals = tuple((x.lower.end, x.upper.end) for x in merged)
    return intervals, (merged[0].lower, merged[-1].upper)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reach:
    """From where to where a branch is likely, infinite where open, and how it ends there."""

    low: float
    high: float
    lower: Side
    upper: Side

    @classmethod
    def of(cls, branch: Branch) -> "_Reach":
        lower, upper = branch.lower.side, branch.upper.side
        return cls(low=_reach(lower, -np.inf), high=_reach(upper, np.inf), lower=lower, upper=upper)

    def goes_on_to(self, other: "_Reach") -> bool:
        """Whether no value between this and one that begins higher is excluded by the data."""
        at_boundary = SideStatus.OPEN_AT_FEASIBILITY
        is_gap = at_boundary in {self.upper.status, other.lower.status}
        return other.low <= self.high or is_gap

    def joined(self, other: "_Reach") -> "_Reach":
        highest = max(self, other, key=lambda x: x.high)
        return replace(self, high=highest.high, upper=highest.upper)


def _reach(side: Side, beyond: float) -> float:
    """Where a side ends; the feasibility boundary where the model does, else `beyond` if open."""
    if side.status is SideStatus.OPEN_AT_FEASIBILITY:
        return side.reached
    return beyond if side.end is None else side.end


def _envelope(walk: Walk, branches: Sequence[Branch]) -> list[tuple[Point, int]]:
    """Points from low to high values with their branch, without those above another branch."""
    kept: list[tuple[Point, int]] = []
    for k, branch in enumerate(branches):
        others = [x for x in branches if x is not branch]
        for point in branch.points:
            height = walk.delta(point) - AT_END * walk.threshold
            if all(_height(walk, other, point.value) >= height for other in others):
                kept.append((point, k))
    kept.sort(key=lambda x: x[0].value)
    places = [x[0].value for x in kept]
    return [x for i, x in enumerate(kept) if i == 0 or places[i] > places[i - 1]]


def curve_slopes(walk: Walk, points: Sequence[Point]) -> Array:
    """Slopes of the curve, shape ``(k,)``; of its chords where a fit stopped at the boundary.

    What such a fit's derivatives give is the slope of the model beyond the boundary.
    """
    exact = np.array([x.slope for x in points])
    if len(points) < 2:
        return exact
    chords = np.gradient([walk.delta(x) for x in points], [x.value for x in points])
    return np.where([walk.is_settled(x) for x in points], exact, chords)


def _height(walk: Walk, branch: Branch, value: float) -> float:
    """Rise of the deviance of a branch at a value, infinite outside of what was walked."""
    for left, right in pairwise(branch.points):
        if left.value <= value <= right.value and left.value < right.value:
            return cubic(
                value,
                (left.value, walk.delta(left), left.slope),
                (right.value, walk.delta(right), right.slope),
            )
    return np.inf


def _verdict(
    walk: Walk, origin: Point, sides: tuple[Side, Side], intervals: tuple[Interval, ...]
) -> ProfileVerdict:
    if len(intervals) > 1:
        return ProfileVerdict.MULTIMODAL
    if any(x.status in UNDECIDED for x in sides):
        return ProfileVerdict.UNDETERMINED
    n_closed = sum(x.status is SideStatus.CLOSED for x in sides)
    if n_closed == 2:
        return ProfileVerdict.IDENTIFIABLE
    if n_closed == 1:
        return ProfileVerdict.ONE_SIDED
    is_flat = all(x.max_deviance <= FLAT * walk.threshold for x in sides)
    if is_flat and _is_unseen(walk, origin):
        return ProfileVerdict.STRUCTURALLY_SUSPECT
    return ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE


def _is_unseen(walk: Walk, origin: Point) -> bool:
    """Whether the quantity changes along a direction in which no residual does."""
    scales = conditional_sds(origin.evaluation.jacobian, walk.evaluator.parameters)
    gradient = walk.quantity.evaluate(origin.evaluation.theta)[1] * scales
    matrix = origin.evaluation.jacobian * scales
    padded = np.vstack([matrix, np.zeros((matrix.shape[1], matrix.shape[1]))])
    _, values, directions = np.linalg.svd(padded, full_matrices=False)
    unseen = directions[values <= UNSEEN_TOLERANCE * max(values[0], 1e-300)] @ gradient
    return bool(np.linalg.norm(unseen) > UNSEEN * np.linalg.norm(gradient))


def _level(side: Side, level: float, threshold: float) -> float:
    if side.status is SideStatus.CLOSED:
        return level
    law = scipy.stats.chi2(1)
    return float(law.cdf(side.max_deviance * law.ppf(level) / threshold))
