"""The profile likelihood of a parameter or any other quantity."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypedDict, Unpack

import numpy as np
import scipy
from numpy.typing import ArrayLike

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.fit import Fit, fit_many
from identknee.calibrate.problem import (
    UNSEEN_TOLERANCE,
    Evaluation,
    Evaluator,
    ParameterQuantity,
    Problem,
    Quantity,
    conditional_sds,
    evaluate,
    thin_svd,
    value_at,
    with_room_doubled,
)
from identknee.identify.profile.branches import (
    Branch,
    constant_branches,
    find_branches,
    height_at,
    walk_branch,
)
from identknee.identify.profile.origins import (
    MOVED,
    ClosedEnd,
    OriginFinder,
    bounds_in_the_way,
    optimum_with_room,
)
from identknee.identify.profile.result import (
    EndOrigin,
    Interval,
    Profile,
    ProfileVerdict,
    Side,
    SideStatus,
    chi2_threshold,
)
from identknee.identify.profile.walk import (
    AT_END,
    BETTER,
    CLEARLY_BETTER,
    FLAT,
    JUMP,
    BetterOptimumFound,
    ProfileContext,
    ProfilePoint,
    fit_from_nearby,
)
from identknee.identify.sweep import sobol_starts
from identknee.runs.declare import OF_PARAMETER, Array, array, declared, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.record import Outcome
from identknee.runs.schema import from_plain, to_plain
from identknee.runs.store import Store, resumable_map


@declared
class PolishedOptimum:
    """An optimum polished for profiles, from `polish_optimum`."""

    theta: Array = array("Where it is", "parameter", unit=OF_PARAMETER)
    with_room: Array | None = array(
        "Where the fit ends with twice the room for all parameters; None where no bound is active",
        "parameter",
        unit=OF_PARAMETER,
        default=None,
    )
    beyond: tuple[Array, ...] = entry(
        "Likely optima outside the bounds, shape ``(n,)`` each: ends that would move from there "
        "are set by bounds",
        unit=OF_PARAMETER,
        default=(),
    )


# Of the quantity's gradient: what may lie in directions that the data do not see.
UNSEEN = 1e-3
UNDECIDED = (SideStatus.OPEN_BUDGET, SideStatus.FAILED)


def assembled(
    walk: ProfileContext,
    problem: Problem,
    branches: Sequence[Branch],
    *,
    optimum: PolishedOptimum,
    level: float,
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
    optimum
        The optimum that the profile was to begin at.
    level
        Confidence level that the threshold stands for.
    n_restarts
        How often the profile was started over from a better optimum.
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
    finder = OriginFinder(
        walk,
        problem,
        origin.evaluation,
        optimum.beyond,
        optimum.with_room if not n_restarts else None,
    )
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
            if all(height_at(walk, other, point.value) >= height for other in others):
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
        better_optimum=origin.evaluation.theta if n_restarts else None,
        n_restarts=n_restarts,
    )


def above_lower_fit(profile: Profile, fit: Evaluation, value: float) -> Profile | None:
    """The profile above a fit that is a little lower than its own; None where it says too little.

    Rises are larger, and ends lie farther inside, where their slopes lead to. Where the value at
    the fit is not in the set, or the set would end on a side that was open, the profile has to be
    walked again.

    Parameters
    ----------
    profile
        A profile.
    fit
        The best fit known now.
    value
        The quantity there.
    """
    gain = profile.deviance - fit.deviance
    deltas = profile.deltas + gain

    def moved(end: float | None, direction: int) -> float | None:
        if end is None:
            return None
        i = int(np.argmin(np.abs(profile.values - end)))
        slope = direction * profile.slopes[i]
        excess = deltas[i] + profile.slopes[i] * (end - profile.values[i]) - profile.threshold
        within = direction * (end - profile.values[deltas < profile.threshold])
        room = min(within[within > 0.0], default=0.0)
        return end - direction * (min(excess / slope, room) if min(excess, slope) > 0.0 else 0.0)

    intervals = tuple((moved(low, -1), moved(high, 1)) for low, high in profile.intervals)
    sides = [
        replace(side, end=end, max_deviance=side.max_deviance + gain)
        for side, end in (
            (profile.lower_side, intervals[0][0]),
            (profile.upper_side, intervals[-1][1]),
        )
    ]
    is_open = [x.max_deviance for x in sides if x.end is None]
    if max(is_open, default=0.0) >= profile.threshold or not any(
        (low is None or low <= value) and (high is None or value <= high) for low, high in intervals
    ):
        return None
    return replace(
        profile,
        optimum=fit.theta,
        optimum_value=value,
        better_optimum=fit.theta,
        deviance=fit.deviance,
        deltas=deltas,
        intervals=intervals,
        lower_side=sides[0],
        upper_side=sides[1],
        practical_level=min(_level(x, profile.level, profile.threshold) for x in sides),
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
    met anywhere starts everything over from it, at most five times. Where it is only a little
    better, beside nuisances or at the feasibility boundary, the ends are moved instead.

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
    evaluator = Evaluator(problem, budget=budget)
    optimum = optimum_theta
    if not isinstance(optimum, PolishedOptimum):
        theta = np.asarray(optimum, dtype=np.float64)
        optimum = PolishedOptimum(theta=_settled(evaluator, theta, threshold).theta)
    run = _Run(
        problem=problem,
        evaluator=evaluator,
        quantity=quantity,
        level=level,
        threshold=threshold,
        starts=np.reshape(np.asarray(starts, dtype=np.float64), (-1, problem.parameters.n)),
        optimum=optimum,
    )
    return run.profile()


def polish_optimum(
    problem: Problem, optimum_theta: ArrayLike, *, threshold: float, budget: int = BUDGET
) -> PolishedOptimum:
    """The polished optimum, shared by several profiles, and the one with twice the room.

    Raises
    ------
    ValueError
        If the model has no prediction at the optimum.
    """
    theta = np.asarray(optimum_theta, dtype=np.float64)
    optimum = _settled(Evaluator(problem, budget=budget), theta, threshold)
    with_room = None
    if bounds_in_the_way(problem, optimum, threshold=threshold):
        wider = with_room_doubled(problem, problem.parameters.names)
        evaluator = Evaluator(wider, budget=budget)
        with_room = optimum_with_room(evaluator, optimum.theta, threshold=threshold).theta
    return PolishedOptimum(theta=optimum.theta, with_room=with_room)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Run:
    problem: Problem
    evaluator: Evaluator
    quantity: Quantity
    level: float
    threshold: float
    starts: Array
    optimum: PolishedOptimum

    def profile(self) -> Profile:
        optimum = self.evaluator(self.optimum.theta)
        starts = list(self.starts)
        for n_restarts in range(MOST_RESTARTS + 1):
            walk = ProfileContext(self.evaluator, self.quantity, self.threshold, optimum)
            walk.is_final = n_restarts == MOST_RESTARTS
            try:
                value, gradient = value_at(self.quantity, optimum.theta)
                origin = walk.point(walk.solve(value, optimum.theta, tolerance=np.inf))
                if not gradient.any():
                    branches = constant_branches(walk, origin)
                else:
                    branches = find_branches(walk, walk_branch(walk, origin), starts)
            except BetterOptimumFound as found:
                starts.insert(0, optimum.theta)
                optimum = _settled(self.evaluator, found.theta, self.threshold)
                continue
            made = assembled(
                walk,
                self.problem,
                branches,
                optimum=self.optimum,
                level=self.level,
                n_restarts=n_restarts,
            )
            if walk.best.deviance >= made.deviance - BETTER * self.threshold:
                return made
            starts.insert(0, optimum.theta)
            n_before = self.evaluator.n_simulations
            optimum = _settled(self.evaluator, walk.best.theta, self.threshold)
            n_polishing = self.evaluator.n_simulations - n_before
            value, _ = self.quantity.evaluate(optimum.theta)
            above = above_lower_fit(made, optimum, value)
            if above is not None and made.deviance - optimum.deviance <= walk.least_gain:
                return replace(above, n_simulations=made.n_simulations + n_polishing)
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
            partial(_polished, problem, theta, max(each)),
            [settings.get("budget", BUDGET)],
            executor=serial,
            store=store,
            name=f"optimum round {round_}",
            description="polishing",
        )
        optimum = replace(from_plain(PolishedOptimum, polished), beyond=beyond)
        theta = optimum.theta
        if found and not problem.parameters.is_of_interest.all():
            fit = evaluate(problem, theta)
            above = [
                above_lower_fit(x, fit, value_at(quantity, theta)[0])
                for x, quantity in zip(found, quantities, strict=True)
                if x.deviance - fit.deviance <= CLEARLY_BETTER * x.threshold
            ]
            kept = [x for x in above if x is not None]
            if len(kept) == len(found):
                return tuple(kept)
        for quantity in quantities:
            value_at(quantity, theta)
        made = resumable_map(
            partial(_profiled, problem, optimum, asked, {**settings, "starts": starts}),
            range(len(asked)),
            executor=executor,
            store=store,
            name=f"profile round {round_}",
            description="profiling",
        )
        found = tuple(from_plain(Profile, x) for x in made)
        # Once more from the lowest of the better optima met, unless all profiles start from it.
        lowest = min(found, key=lambda x: x.deviance)
        # A hundredth of what would start one profile over.
        if lowest.better_optimum is None or all(
            x.deviance <= lowest.deviance + 1e-6 * lowest.threshold for x in found
        ):
            break
        starts = [theta, *np.reshape(starts, (-1, theta.size))]
        theta = np.array(lowest.better_optimum)
    return found


def other_optima(
    problem: Problem,
    optimum_theta: ArrayLike,
    *,
    threshold: float,
    known: Sequence[Fit] = (),
    seed: int = 0,
    executor: Executor = serial,
) -> Array:
    """Other likely optima, shape ``(k, n)``, where sixteen fits from all over the box end.

    They are the `starts` of profiles: paths of solutions in which parameters exchange their roles,
    or of a second valley, are found through them. None are looked for in a box without ends. The
    lowest comes first.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable if `executor` runs processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    threshold
        Rise of the deviance up to which an optimum is likely.
    known
        Fits made before, which may have ended at such optima.
    seed
        Seed of the Sobol points that the fits start from.
    executor
        Anything with an ordered ``map``.
    """
    parameters = problem.parameters
    fits = list(known)
    if np.isfinite(parameters.upper - parameters.lower).all():
        starts = sobol_starts(parameters, N_STARTS, seed=seed)
        fits += fit_many(problem, starts, seed=seed, executor=executor, budget=FIT_BUDGET)
    at = evaluate(problem, np.asarray(optimum_theta, dtype=np.float64))
    found = [at]
    for fit in sorted(fits, key=lambda x: x.objective):
        if not 2.0 * fit.objective < at.deviance + threshold:
            break
        here = evaluate(problem, fit.theta)
        if not here.is_finite:
            continue
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


def _polished(problem: Problem, theta: Array, threshold: float, budget: int) -> dict[str, Any]:
    return to_plain(polish_optimum(problem, theta, threshold=threshold, budget=budget))


def _profiled(
    problem: Problem,
    optimum: PolishedOptimum,
    asked: Sequence[tuple[Quantity, float]],
    settings: dict[str, Any],
    which: int,
) -> dict[str, Any]:
    quantity, threshold = asked[which]
    return to_plain(profile(problem, optimum, quantity, threshold=threshold, **settings))
