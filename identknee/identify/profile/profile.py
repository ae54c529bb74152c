"""The profile likelihood of a parameter or any other quantity."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, TypedDict, Unpack

import numpy as np
import scipy
from numpy.typing import ArrayLike

from identknee.calibrate.bounded_least_squares import IsEnough, minimise
from identknee.calibrate.fit import fit_many
from identknee.calibrate.problem import (
    EIGENVALUE_TOLERANCE,
    UNSEEN_TOLERANCE,
    Evaluation,
    Evaluator,
    ParameterQuantity,
    Problem,
    Quantity,
    conditional_sds,
    evaluate,
    thin_svd,
    typical_steps,
    value_at,
    with_room_doubled,
)
from identknee.identify.profile.origins import MOVED, ClosedEnd, OriginFinder
from identknee.identify.profile.result import (
    EndOrigin,
    Interval,
    Profile,
    ProfileVerdict,
    Side,
    SideStatus,
    chi2_threshold,
    cubic,
)
from identknee.identify.profile.walk import (
    AT_END,
    FLAT,
    JUMP,
    BetterOptimumFound,
    ProfileContext,
    ProfilePoint,
    SideWalk,
    fit_from_nearby,
    march,
)
from identknee.identify.sweep import sobol_starts
from identknee.runs.declare import Array
from identknee.runs.executors import Executor, serial
from identknee.runs.record import Outcome
from identknee.runs.schema import from_plain, to_plain
from identknee.runs.store import Store, resumable_map

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


def walk_branch(walk: ProfileContext, origin: ProfilePoint) -> Branch:
    """The profile from an optimum downward and upward."""
    return Branch(lower=march(walk, origin, -1), upper=march(walk, origin, 1))


def constant_branches(walk: ProfileContext, origin: ProfilePoint) -> list[Branch]:
    """The branches of a quantity that is locally constant, such as a slack line's force.

    Its set begins as that one value. Where it is another one at an end of the confidence set of a
    parameter, by the covariance at the optimum, the fit there with the largest and the smallest
    value begin branches of their own.
    """
    side = Side(
        status=SideStatus.CLOSED,
        end=origin.value,
        error=0.0,
        reached=origin.value,
        max_deviance=0.0,
        at_bounds=(),
    )
    leg = SideWalk(points=(origin,), side=side)
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


def find_branches(walk: ProfileContext, main: Branch, starts: Array) -> list[Branch]:
    """The branches of the optimum and of other local optima found.

    Fits without a constraint start from the middle of what lies beyond each closed end, and from
    each of `starts`. Where one ends at a likely optimum that is not on a path walked before, its
    own branch is walked, and the gaps that it leaves are looked into in their turn. Paths that lead
    to no optimum of their own are looked for by coming back to each end of the optimum's branch
    from outside.
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
        branch = _branch_beyond_end(walk, leg, direction)
        if branch is not None and not _is_known(walk, branches, branch.origin):
            branches.append(branch)
    for start in starts:
        branch = _branch_from(walk, branches, start)
        if branch is not None and len(branches) < MOST_BRANCHES:
            branches.append(branch)
    return branches


def _beside(branch: Branch, region: Region) -> list[Region]:
    """The parts of a range of values below and above a branch."""
    low, high = branch.limits
    below, above = (region[0], low), (high, region[1])
    return [x for x in (below, above) if x[0] < x[1] and not np.isinf(low if x is below else high)]


def _branch_beyond_end(walk: ProfileContext, leg: SideWalk, direction: int) -> Branch | None:
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
        return walk_branch(walk, far)
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
            return walk_branch(walk, back)
    return None


def _rough_fit(
    walk: ProfileContext,
    value: float,
    start: Array,
    *,
    most_steps: int = EXPLORATORY_STEPS,
    is_enough: IsEnough | None = None,
) -> ProfilePoint | None:
    """A rough constrained fit at a value; None if it failed or stopped early."""
    solved = walk.solve(
        value,
        start,
        tolerance=GLANCE_TOLERANCE * walk.threshold,
        most_steps=most_steps,
        is_enough=is_enough,
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
    walk.note(found.evaluation)
    point = _point(walk, found.evaluation.theta)
    if point is None or walk.delta(point) >= walk.threshold or _is_known(walk, branches, point):
        return None
    return walk_branch(walk, point)


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


# Of the quantity's gradient: what may lie in directions that the data do not see.
UNSEEN = 1e-3
UNDECIDED = (SideStatus.OPEN_BUDGET, SideStatus.FAILED)


def assembled(
    walk: ProfileContext,
    problem: Problem,
    branches: Sequence[Branch],
    *,
    beyond: Sequence[Array],
    level: float,
    better_optimum: Array | None,
    n_restarts: int,
) -> Profile:
    """The profile that the branches make together: their lower envelope and their union.

    Parameters
    ----------
    walk
        The quantity and the threshold.
    problem
        The problem whose profile it is.
    branches
        That of the optimum first.
    beyond
        Likely optima outside the bounds, shape ``(n,)`` each.
    level
        Confidence level that the threshold stands for.
    better_optimum, n_restarts
        The optimum, where it is not the one given, and how often the profile was started over.
    """
    origin = branches[0].origin
    # Intervals are separate where the data exclude what lies between. Where only the model ends
    # between them, nothing does, and they are one.
    ends = [(x.lower.side, x.upper.side) for x in branches]
    reaches = [(_reach(x, -np.inf), _reach(y, np.inf), x, y) for x, y in ends]
    merged: list[tuple[float, Side, Side]] = []
    for low, high, lower, upper in sorted(reaches, key=lambda x: x[:2]):
        if merged:
            highest, first, last = merged[-1]
            is_gap = SideStatus.OPEN_AT_FEASIBILITY in {last.status, lower.status}
            if low <= highest or is_gap:
                merged[-1] = (high, first, upper) if high > highest else merged[-1]
                continue
        merged.append((high, lower, upper))
    intervals = tuple((lower.end, upper.end) for _, lower, upper in merged)
    finder = OriginFinder(walk, problem, origin.evaluation, beyond)
    sides = (
        _with_origin(finder, branches, merged[0][1], intervals[0], -1),
        _with_origin(finder, branches, merged[-1][2], intervals[-1], 1),
    )
    # Points from low to high values with their branch, without those above another branch.
    kept: list[tuple[ProfilePoint, int]] = []
    for i, branch in enumerate(branches):
        others = [x for x in branches if x is not branch]
        for point in branch.points:
            height = walk.delta(point) - AT_END * walk.threshold
            if all(_height(walk, other, point.value) >= height for other in others):
                kept.append((point, i))
    kept.sort(key=lambda x: x[0].value)
    places = [x[0].value for x in kept]
    curve = [x for i, x in enumerate(kept) if i == 0 or places[i] > places[i - 1]]
    closed = [x for x in sides if x.status is SideStatus.CLOSED]
    is_flat = all(x.max_deviance <= FLAT * walk.threshold for x in sides)
    verdict = ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE
    if len(intervals) > 1:
        verdict = ProfileVerdict.MULTIMODAL
    elif any(x.status in UNDECIDED for x in sides) or any(x.made_by is None for x in closed):
        verdict = ProfileVerdict.UNDETERMINED
    elif any(x.made_by is not EndOrigin.DATA for x in closed):
        verdict = ProfileVerdict.BOUNDED_BY_ASSUMPTION
    elif closed:
        verdict = (ProfileVerdict.ONE_SIDED, ProfileVerdict.IDENTIFIABLE)[len(closed) - 1]
    elif is_flat and _is_structurally_flat(walk, origin):
        verdict = ProfileVerdict.STRUCTURALLY_SUSPECT
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
        verdict=verdict,
        practical_level=min(_level(x, level, walk.threshold) for x in sides),
        n_simulations=walk.evaluator.n_simulations + finder.n_simulations,
        better_optimum=better_optimum,
        n_restarts=n_restarts,
    )


def _with_origin(
    finder: OriginFinder,
    branches: Sequence[Branch],
    side: Side,
    interval: Interval,
    direction: int,
) -> Side:
    """The side with what makes its end; itself where it is open."""
    if side.end is None:
        return side
    branch = next(x for x in branches if side in (x.lower.side, x.upper.side))
    low, high = interval
    width = abs(side.end - branch.origin.value) if low is None or high is None else high - low
    end = ClosedEnd(
        side=side,
        value=side.end,
        direction=direction,
        width=width,
        nearest=branch.nearest(side.end),
        inside=branch.nearest(side.end - direction * MOVED * width),
    )
    return finder.side(end)


def _reach(side: Side, beyond: float) -> float:
    """Where a side ends; the feasibility boundary where the model does, else `beyond` if open."""
    if side.status is SideStatus.OPEN_AT_FEASIBILITY:
        return side.reached
    return beyond if side.end is None else side.end


def curve_slopes(walk: ProfileContext, points: Sequence[ProfilePoint]) -> Array:
    """Slopes of the curve, shape ``(k,)``; of its chords where a fit stopped at the boundary.

    What such a fit's derivatives give is the slope of the model beyond the boundary.
    """
    exact = np.array([x.slope for x in points])
    if len(points) < 2:
        return exact
    chords = np.gradient([walk.delta(x) for x in points], [x.value for x in points])
    return np.where([walk.is_settled(x) for x in points], exact, chords)


def _height(walk: ProfileContext, branch: Branch, value: float) -> float:
    """Rise of the deviance of a branch at a value; infinite outside its range."""
    for left, right in pairwise(branch.points):
        if left.value <= value <= right.value and left.value < right.value:
            return cubic(
                value,
                (left.value, walk.delta(left), left.slope),
                (right.value, walk.delta(right), right.slope),
            )
    return np.inf


def _is_structurally_flat(walk: ProfileContext, origin: ProfilePoint) -> bool:
    """Whether the quantity varies along a direction in which no residual does."""
    scales = conditional_sds(origin.evaluation.jacobian, walk.evaluator.parameters)
    gradient = walk.quantity.evaluate(origin.evaluation.theta)[1] * scales
    matrix = origin.evaluation.jacobian * scales
    padded = np.vstack([matrix, np.zeros((matrix.shape[1], matrix.shape[1]))])
    _, values, directions = thin_svd(padded)
    unseen = directions[values <= UNSEEN_TOLERANCE * max(values[0], 1e-300)] @ gradient
    return bool(np.linalg.norm(unseen) > UNSEEN * np.linalg.norm(gradient))


def _level(side: Side, level: float, threshold: float) -> float:
    if side.status is SideStatus.CLOSED:
        return level
    law = scipy.stats.chi2(1)
    return float(law.cdf(side.max_deviance * law.ppf(level) / threshold))


LEVEL = 0.95
BUDGET = 1000
MOST_RESTARTS = 5
# Of the deviance: predicted reduction that the optimum may leave.
OPTIMUM_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PolishedOptimum:
    """An optimum polished for profiles, from `polish_optimum`.

    Attributes
    ----------
    theta
        Where it is, shape ``(n,)``.
    beyond
        Likely optima outside the bounds, shape ``(n,)`` each: ends that would move from there are
        set by bounds.
    """

    theta: Array
    beyond: tuple[Array, ...] = ()


def profile(
    problem: Problem,
    optimum_theta: ArrayLike | PolishedOptimum,
    quantity: Quantity,
    *,
    level: float = LEVEL,
    threshold: float | None = None,
    budget: int = BUDGET,
    starts: ArrayLike = (),
) -> Profile:
    """The profile likelihood of a quantity and its confidence set.

    The optimum is polished first. From it the profile is walked outward on both sides; then a fit
    far beyond each end looks for another valley and approaches the end from there. A better fit
    met anywhere starts everything over from it, at most five times.

    That looks along the quantity only. Optima in which other parameters exchange their roles are
    found from `starts` alone; `identknee.identify.profile.profile.profile_quantities` looks for
    them by itself.

    Parameters
    ----------
    problem
        Residuals in units of their noise.
    optimum_theta
        The best fit known, shape ``(n,)``. What `polish_optimum` makes of it is not polished again.
    quantity
        What to profile: a parameter or any function of theta.
    level
        Confidence level of the set.
    threshold
        Rise of the deviance that bounds it; that of the chi-squared law if None. See
        `identknee.identify.profile.result` for unknown noise and for few data.
    budget
        Simulations allowed.
    starts
        Other local optima, or places to look for them from, shape ``(k, n)``: for example the
        basins of a sweep, or `identknee.identify.profile.profile.other_optima`. Where one is
        likely, its own path counts too; at most twelve paths are walked.

    Raises
    ------
    ValueError
        If the level, the threshold or the budget is not one possible, or the model has no
        prediction at the optimum.
    """
    likely = chi2_threshold(level)
    threshold = likely if threshold is None else threshold
    if not 0.0 < threshold < np.inf:
        raise ValueError(f"the threshold must be positive and finite, got {threshold:g}")
    if budget < 1:
        raise ValueError(f"the budget must be at least 1 simulation, got {budget}")
    run = _Run(
        problem=problem,
        evaluator=Evaluator(problem, budget=budget),
        quantity=quantity,
        level=level,
        threshold=threshold,
        starts=np.reshape(np.asarray(starts, dtype=np.float64), (-1, problem.parameters.n)),
    )
    if isinstance(optimum_theta, PolishedOptimum):
        run = replace(run, beyond=optimum_theta.beyond)
        return run.profile(run.evaluator(optimum_theta.theta))
    theta = np.asarray(optimum_theta, dtype=np.float64)
    return run.profile(_settled(run.evaluator, theta, threshold))


def polish_optimum(
    problem: Problem, optimum_theta: ArrayLike, *, threshold: float, budget: int = BUDGET
) -> PolishedOptimum:
    """The polished optimum, shared by several profiles.

    Raises
    ------
    ValueError
        If the model has no prediction at the optimum.
    """
    theta = np.asarray(optimum_theta, dtype=np.float64)
    return PolishedOptimum(
        theta=_settled(Evaluator(problem, budget=budget), theta, threshold).theta
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Run:
    problem: Problem
    evaluator: Evaluator
    quantity: Quantity
    level: float
    threshold: float
    starts: Array
    beyond: tuple[Array, ...] = ()

    def profile(self, optimum: Evaluation) -> Profile:
        for n_restarts in range(MOST_RESTARTS + 1):
            walk = ProfileContext(self.evaluator, self.quantity, self.threshold, optimum)
            walk.is_final = n_restarts == MOST_RESTARTS
            try:
                value, gradient = value_at(self.quantity, optimum.theta)
                origin = walk.point(walk.solve(value, optimum.theta, tolerance=np.inf))
                if not gradient.any():
                    branches = constant_branches(walk, origin)
                else:
                    branches = find_branches(walk, walk_branch(walk, origin), self.starts)
            except BetterOptimumFound as found:
                optimum = _settled(self.evaluator, found.theta, self.threshold)
                continue
            return assembled(
                walk,
                self.problem,
                branches,
                beyond=self.beyond,
                level=self.level,
                better_optimum=optimum.theta if n_restarts else None,
                n_restarts=n_restarts,
            )
        raise AssertionError  # pragma: no cover - the last round meets nothing better


def _settled(evaluator: Evaluator, theta: Array, threshold: float) -> Evaluation:
    optimum = minimise(evaluator, theta, tolerance=OPTIMUM_TOLERANCE)
    if optimum.outcome is Outcome.START_FAILED:
        raise ValueError(
            "the model has no prediction at the optimum given; fit it first, or profile from "
            "another parameter set"
        )
    if optimum.outcome is Outcome.CLIFF:
        around = fit_from_nearby(
            evaluator,
            optimum.evaluation,
            quantity=None,
            target=np.nan,
            rise=threshold,
            tolerance=OPTIMUM_TOLERANCE,
        )
        if around is not None and around.evaluation.deviance < optimum.evaluation.deviance:
            return around.evaluation
    return optimum.evaluation


MOST_ROUNDS = 3
N_STARTS = 16
# Of a fit that looks for another optimum.
FIT_BUDGET = 200


class ProfileSettings(TypedDict, total=False):
    """What is passed on to each `profile`, by the same names."""

    level: float
    thresholds: ArrayLike | None
    budget: int
    starts: ArrayLike | None


def profile_parameters(
    problem: Problem,
    optimum_theta: ArrayLike,
    names: Sequence[str] | None = None,
    *,
    executor: Executor = serial,
    store: Store | None = None,
    **settings: Unpack[ProfileSettings],
) -> tuple[Profile, ...]:
    """One profile for each parameter, in their order: `profile_quantities` of parameters.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable if `executor` runs processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    names
        Which parameters; all if None.
    executor
        Anything with an ordered ``map``.
    store
        Where finished profiles are kept; from `identknee.runs.store.open_work`.
    settings
        As for `profile_quantities`.

    Raises
    ------
    ValueError
        If a name is not a parameter's, or as `profile` does.
    """
    parameters = problem.parameters
    chosen = parameters.names if names is None else names
    quantities = [ParameterQuantity(parameters=parameters, name=name) for name in chosen]
    return profile_quantities(
        problem, optimum_theta, quantities, executor=executor, store=store, **settings
    )


def profile_quantities(
    problem: Problem,
    optimum_theta: ArrayLike,
    quantities: Sequence[Quantity],
    *,
    executor: Executor = serial,
    store: Store | None = None,
    **settings: Unpack[ProfileSettings],
) -> tuple[Profile, ...]:
    """One profile for each quantity, in their order, all from the same optimum.

    Other likely optima are looked for once, by `other_optima`, and their paths count in every
    profile; pass ``starts`` if they are known, or an empty tuple to do without. Where one of the
    profiles meets a better fit, all are walked again from the best that was met, at most three
    times.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable, as the quantities, if `executor` runs
        processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    quantities
        What to profile, over the same parameters.
    executor
        Anything with an ordered ``map``.
    store
        Where finished profiles are kept; from `identknee.runs.store.open_work`.
    settings
        Those of `profile`: ``level, budget, starts``, and ``thresholds``: one for all, or one each.
        The simulations that polish the optimum and look for other optima are no profile's, and
        not among theirs.

    Raises
    ------
    ValueError
        As `profile` does.
    """
    if not quantities:
        return ()
    theta = np.asarray(optimum_theta, dtype=np.float64)
    thresholds, starts = settings.pop("thresholds", None), settings.pop("starts", None)
    if thresholds is None:
        thresholds = chi2_threshold(settings.get("level", LEVEL))
    each = np.broadcast_to(np.asarray(thresholds, float), len(quantities)).tolist()
    if starts is None:
        starts = other_optima(problem, theta, threshold=max(each), executor=executor)
    looked = [theta, *np.reshape(starts, (-1, theta.size))]
    beyond = optima_beyond_bounds(problem, looked, threshold=max(each), executor=executor)
    # Sent together, problem and quantities keep the one model that they share simulations by.
    asked = list(zip(quantities, each, strict=True))
    found: tuple[Profile, ...] = ()
    for round_ in range(MOST_ROUNDS):
        (polished,) = resumable_map(
            partial(_all_settled, problem, theta, max(each)),
            [settings.get("budget", BUDGET)],
            executor=serial,
            store=store,
            name=f"optimum round {round_}",
            description="polishing",
        )
        theta = np.array(polished)
        for quantity in quantities:
            value_at(quantity, theta)
        kept = resumable_map(
            partial(_profiled, problem, theta, asked, beyond, {**settings, "starts": starts}),
            range(len(asked)),
            executor=executor,
            store=store,
            name=f"profile round {round_}",
            description="profiling",
        )
        found = tuple(from_plain(Profile, x) for x in kept)
        # Once more from the lowest of the better optima met, unless all profiles start from it.
        lowest = min(found, key=lambda x: x.deviance)
        # A hundredth of what would start one profile over.
        if lowest.better_optimum is None or all(
            x.deviance <= lowest.deviance + 1e-6 * lowest.threshold for x in found
        ):
            break
        theta = np.array(lowest.better_optimum)
    return found


def other_optima(
    problem: Problem,
    optimum_theta: ArrayLike,
    *,
    threshold: float,
    seed: int = 0,
    executor: Executor = serial,
) -> Array:
    """Other likely optima, shape ``(k, n)``, where sixteen fits from all over the box end.

    They are the `starts` of profiles: paths of solutions in which parameters exchange their roles,
    or of a second valley, are found through them. None are looked for in a box without ends.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable if `executor` runs processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    threshold
        Rise of the deviance up to which an optimum is likely.
    seed
        Seed of the Sobol points that the fits start from.
    executor
        Anything with an ordered ``map``.
    """
    parameters = problem.parameters
    if not np.isfinite(parameters.upper - parameters.lower).all():
        return np.empty((0, parameters.n))
    at = evaluate(problem, np.asarray(optimum_theta, dtype=np.float64))
    starts = sobol_starts(parameters, N_STARTS, seed=seed)
    fits = fit_many(problem, starts, seed=seed, executor=executor, budget=FIT_BUDGET)
    found = [at]
    for fit in sorted(fits, key=lambda x: x.objective):
        if not 2.0 * fit.objective < at.deviance + threshold:
            break
        here = evaluate(problem, fit.theta)
        apart = [here.jacobian @ (here.theta - other.theta) for other in found]
        if min(float(x @ x) for x in apart) > JUMP * threshold:
            found.append(here)
    return np.reshape([x.theta for x in found[1:]], (-1, parameters.n))


def optima_beyond_bounds(
    problem: Problem, thetas: Sequence[Array], *, threshold: float, executor: Executor = serial
) -> tuple[Array, ...]:
    """Likely optima outside the bounds, with twice the room for all parameters.

    None are looked for in a box without ends, nor beside nuisances, which make such searches too
    long.

    Parameters
    ----------
    problem
        Residuals in units of their noise.
    thetas
        The best fit, then other optima within the bounds, and where to look from as well.
    threshold
        Rise of the deviance above the best fit up to which an optimum is likely.
    executor
        Anything with an ordered ``map``.
    """
    parameters = problem.parameters
    is_boxed = np.isfinite(parameters.upper - parameters.lower).all()
    if not is_boxed or not parameters.is_of_interest.all():
        return ()
    most = evaluate(problem, thetas[0]).deviance + threshold
    wider = with_room_doubled(problem, parameters.names)
    fits = fit_many(wider, np.array(thetas), executor=executor, budget=FIT_BUDGET)
    found = [x.theta for x in fits if x.deviance < most]
    return tuple(x for x in found if np.any((x < parameters.lower) | (x > parameters.upper)))


def _all_settled(problem: Problem, theta: Array, threshold: float, budget: int) -> list[float]:
    optimum = polish_optimum(problem, theta, threshold=threshold, budget=budget)
    return [float(x) for x in optimum.theta]


def _profiled(
    problem: Problem,
    theta: Array,
    asked: Sequence[tuple[Quantity, float]],
    beyond: tuple[Array, ...],
    settings: dict[str, Any],
    which: int,
) -> dict[str, Any]:
    quantity, threshold = asked[which]
    optimum = PolishedOptimum(theta=theta, beyond=beyond)
    return to_plain(profile(problem, optimum, quantity, threshold=threshold, **settings))
