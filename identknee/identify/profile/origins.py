"""What sets the ends of a profile: data, prior, limits, or the bound of another parameter."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import (
    Evaluation,
    Evaluator,
    ParameterQuantity,
    Problem,
    Quantity,
    limit_rows,
    n_prior_rows,
    sum_of_squares,
    with_room_doubled,
)
from identknee.identify.profile.result import EndOrigin, Side, SideStatus
from identknee.identify.profile.walk import AT_END, ProfileContext, ProfilePoint, march
from identknee.runs.declare import Array, declared, entry
from identknee.runs.record import Outcome

# Share of the interval: an end that moves by more is set by the bound that was widened.
MOVED = 0.1
# Share of the threshold: a bound is active if widening it is predicted to lower the deviance
# by more.
ACTIVE = 1e-3
# Share of the rise of the deviance: priors and limits that make more set the end.
MOST = 0.5
# Share of the threshold: error of fits that decide whether a value is excluded.
TOLERANCE = 1e-2
# Share of the interval: a value that is as good as another one.
CLOSE = 1e-3
# How much larger a predicted reduction may be farther out.
UNCERTAIN = 2.0
# Bounds that are widened one by one to find the strongest, and the steps allowed for each.
MOST_BOUNDS, MOST_STEPS = 3, 8
NOT_COMPUTED = (SideStatus.OPEN_BUDGET, SideStatus.FAILED)


@declared
class ClosedEnd:
    """A closed end of a set, and the path that it lies on."""

    side: Side = entry("How it ended")
    value: float = entry("The end")
    direction: int = entry("1 for an upper end, -1 for a lower one")
    width: float = entry("Width of the interval that it ends")
    nearest: ProfilePoint = entry("The point of the path nearest to it")
    inside: ProfilePoint = entry("That nearest to the value which is a tenth of the width inside")

    def beyond(self, share: float) -> float:
        """The value so many widths of the interval beyond the end."""
        return self.value + self.direction * share * self.width


def bounds_in_the_way(
    problem: Problem,
    at: Evaluation,
    *,
    threshold: float,
    quantity: Quantity | None = None,
    slope: float = 0.0,
) -> dict[str, float]:
    """Reduction that Lagrange multipliers predict for twice the room, by active bound.

    Parameters
    ----------
    problem
        The problem with its bounds.
    at
        A fit.
    threshold
        Rise of the deviance that bounds the set; bounds that cost less than a thousandth are left
        out.
    quantity, slope
        What the fit holds, and the derivative of the deviance by it; None where nothing is held.
        The bounds of a parameter that is held are left out.
    """
    parameters = problem.parameters
    own = quantity.name if isinstance(quantity, ParameterQuantity) else ""
    force = at.gradient
    if quantity is not None:
        _, gradient = quantity.evaluate(at.theta)
        force = force - slope * np.where(np.isfinite(gradient), gradient, 0.0)
    wider = with_room_doubled(problem, parameters.names).parameters
    found = {}
    for i, name in enumerate(parameters.names):
        room = 0.0
        if at.theta[i] <= parameters.lower[i] and force[i] > 0.0:
            room = parameters.lower[i] - wider.lower[i]
        elif at.theta[i] >= parameters.upper[i] and force[i] < 0.0:
            room = wider.upper[i] - parameters.upper[i]
        gain = float(abs(force[i]) * room)
        if name != own and gain > ACTIVE * threshold:
            found[name] = gain
    return found


def optimum_with_room(evaluator: Evaluator, start: Array, *, threshold: float) -> Evaluation:
    """Where the fit from `start`, shape ``(n,)``, ends in a problem with wider bounds."""
    return minimise(evaluator, start, tolerance=TOLERANCE * threshold).evaluation


class OriginFinder:
    """Finds what sets closed ends of one profile, and counts the simulations for it.

    Parameters
    ----------
    walk
        The quantity, the threshold and the lowest deviance.
    problem
        The problem whose profile it is.
    optimum
        The best fit.
    beyond
        Likely optima outside the bounds, shape ``(n,)`` each.
    with_room
        Where the fit ends with twice the room for all parameters, shape ``(n,)``; None if that is
        not known.
    """

    def __init__(
        self,
        walk: ProfileContext,
        problem: Problem,
        optimum: Evaluation,
        beyond: Sequence[Array],
        with_room: Array | None = None,
    ) -> None:
        self._beyond = tuple(beyond)
        self._room = with_room
        self._widened: tuple[Array, ...] = ()
        self._walk = walk
        self._problem = problem
        self._optimum = optimum
        self._contexts: dict[tuple[str, ...], ProfileContext] = {}

    @property
    def n_simulations(self) -> int:
        """Simulations made so far."""
        return sum(x.evaluator.n_simulations for x in self._contexts.values())

    def side(self, end: ClosedEnd) -> Side:
        """The side with what sets its end; unchanged where that could not be computed.

        An end is set by bounds of other parameters where such a bound is active there or at the
        best fit and, computed again with twice the room for all parameters, the end moves by more
        than a tenth of the interval, or is none any more. Else priors or limits set it where these
        make more than half of the rise of the deviance from the best fit to the end.
        """
        at_end = self._gains(end.nearest.evaluation, end.nearest.slope)
        at_optimum = self._gains(self._optimum, 0.0)
        if (at_end or at_optimum or len(self._beyond)) and end.width > 0.0:
            moves = self._moves_outward(end)
            if moves is False and at_optimum:
                moves = self._moves_inward(end)
            if moves is None:
                return end.side
            if moves:
                gains = at_end or at_optimum
                name = self._strongest(end, gains) if gains else self._farthest_outside()
                return replace(end.side, made_by=EndOrigin.BOUND, bound_of=name)
        return replace(end.side, made_by=self._made_by(end))

    def _gains(self, at: Evaluation, slope: float) -> dict[str, float]:
        return bounds_in_the_way(
            self._problem,
            at,
            threshold=self._walk.threshold,
            quantity=self._walk.quantity,
            slope=slope,
        )

    def _moves_outward(self, end: ClosedEnd) -> bool | None:
        """Whether the end lies farther out with twice the room, up to the quantity's own bounds.

        The fit at the end is begun from there and from the middle of the prior: a bound may
        separate sets in which the parameters exchange their roles. From optima outside the bounds
        the profile is walked to beyond the end.
        """
        walk = self._with_room(self._problem.parameters.names)
        low, high = self._walk.limits
        limits = (max(low, end.beyond(MOVED)), high)
        if end.direction > 0:
            limits = (low, min(high, end.beyond(MOVED)))
        moves: bool | None = False
        for is_own, start in (
            (True, end.nearest.evaluation.theta),
            (False, self._problem.parameters.center),
        ):
            point = self._fit(walk, end, start, is_own=is_own)
            if point is None:
                moves = None
                break
            if walk.delta(point) < (1.0 - TOLERANCE) * walk.threshold:
                walk.limits = limits
                status = march(walk, point, end.direction).side.status
                if status in NOT_COMPUTED:
                    moves = None
                elif status is not SideStatus.CLOSED:
                    moves = True
                    break
            elif is_own and self._may_move(walk, end, point):
                moves = None
        if moves is False:
            walk.limits = limits
            for theta in (*self._beyond, *self._widened):
                value, _ = walk.quantity.evaluate(theta)
                point = walk.point(walk.solve(value, theta, tolerance=np.inf))
                if not np.isfinite(value) or not walk.delta(point) < walk.threshold:
                    continue
                if end.direction * (value - end.beyond(MOVED)) >= 0.0:
                    moves = True
                    break
                reached = march(walk, point, end.direction).side
                if reached.status in NOT_COMPUTED:
                    moves = None
                elif reached.end is None:
                    moves = True
                    break
        return moves

    def _fit(
        self, walk: ProfileContext, end: ClosedEnd, start: Array, *, is_own: bool
    ) -> ProfilePoint | None:
        """The fit at an end with other bounds; None where the budget was used up before.

        Where it is begun at the end's own parameters and the feasibility boundary of the model
        stops it, it is begun again from around them.
        """
        at, tolerance = end.nearest.evaluation, TOLERANCE * walk.threshold
        solved = walk.solve(
            end.value, start, tolerance=tolerance, near=at.theta if is_own else None
        )
        if solved.outcome is Outcome.BUDGET:
            return None
        point = walk.point(solved)
        is_excluded = walk.delta(point) > (1.0 - TOLERANCE) * walk.threshold
        if is_own and is_excluded and self._may_move(walk, end, point):
            around = walk.solve_around(end.value, at, tolerance=tolerance)
            if around is not None and around.evaluation.deviance < solved.evaluation.deviance:
                return walk.point(around)
        return point

    def _may_move(self, walk: ProfileContext, end: ClosedEnd, point: ProfilePoint) -> bool:
        """Whether a fit at an end, stopped by the feasibility boundary, leaves open if it moves.

        By its slopes the end does not move, where a tenth of the width beyond it the deviance has
        risen by twice what it could be lower, had every parameter set a prediction.
        """
        rise = walk.delta(point)
        if self._walk.is_settled(end.nearest):
            rise += MOVED * end.width * max(end.direction * end.nearest.slope, 0.0)
        lowered = rise - UNCERTAIN * point.predicted_reduction
        return not walk.is_settled(point) and lowered <= walk.threshold

    def _moves_inward(self, end: ClosedEnd) -> bool | None:
        """Whether a lower best fit, with twice the room, excludes values well inside the end."""
        walk = self._with_room(self._problem.parameters.names)
        value = end.beyond(-MOVED)
        moves: bool | None = False
        if walk.lowest < self._walk.lowest - AT_END * walk.threshold:
            start = walk.start(value, end.inside, None)
            solved = walk.solve(
                value,
                start,
                tolerance=TOLERANCE * walk.threshold,
                is_enough=lambda at: self._is_likely(walk, at, value, end),
            )
            rise = solved.evaluation.deviance - walk.lowest
            moves = None if solved.outcome is Outcome.BUDGET else rise > walk.threshold
        return moves

    def _is_likely(
        self, walk: ProfileContext, at: Evaluation, value: float, end: ClosedEnd
    ) -> bool:
        """Whether a point at a value, or as good as there, is in the set."""
        there, _ = walk.quantity.evaluate(at.theta)
        is_there = abs(there - value) <= CLOSE * end.width
        return is_there and at.deviance - walk.lowest < (1.0 - TOLERANCE) * walk.threshold

    def _strongest(self, end: ClosedEnd, gains: dict[str, float]) -> str:
        """The active bound that alone lowers the deviance at the end most."""
        names = sorted(gains, key=gains.__getitem__, reverse=True)[:MOST_BOUNDS]
        if len(names) == 1:
            return names[0]
        rises = []
        for name in names:
            walk = self._with_room((name,))
            solved = walk.solve(
                end.value,
                end.nearest.evaluation.theta,
                tolerance=TOLERANCE * walk.threshold,
                most_steps=MOST_STEPS,
            )
            rises.append(solved.evaluation.deviance - walk.lowest)
        return names[int(np.argmin(rises))]

    def _farthest_outside(self) -> str:
        """The parameter farthest outside its bounds at an optimum beyond them."""
        parameters = self._problem.parameters
        room = parameters.upper - parameters.lower
        beyond = np.array(self._beyond)
        outside = np.maximum(parameters.lower - beyond, beyond - parameters.upper)
        return parameters.names[int(np.argmax(np.max(outside / room, axis=0)))]

    def _with_room(self, names: tuple[str, ...]) -> ProfileContext:
        """The profile with twice the room for some parameters, from its own lowest deviance."""
        walk = self._walk
        budget = walk.evaluator.budget
        if budget is not None:
            budget = max(budget - walk.evaluator.n_simulations - self.n_simulations, 0)
        if names in self._contexts:
            wider = self._contexts[names]
            evaluator = wider.evaluator
            evaluator.budget = None if budget is None else evaluator.n_simulations + budget
            wider.limits = walk.limits
            return wider
        evaluator = Evaluator(with_room_doubled(self._problem, names), budget=budget)
        wider = ProfileContext(evaluator, walk.quantity, walk.threshold, self._optimum)
        wider.is_final = True
        wider.lowest = walk.lowest
        self._contexts[names] = wider
        if any(x in names for x in self._gains(self._optimum, 0.0)):
            start = self._optimum.theta
            if self._room is not None and len(names) == self._problem.parameters.n:
                start = self._room
            best = optimum_with_room(evaluator, start, threshold=walk.threshold)
            wider.note(best)
            if self._problem.parameters.is_of_interest.all():
                self._widened = (best.theta,)
        return wider

    def _made_by(self, end: ClosedEnd) -> EndOrigin:
        """Data; or priors or limits, whichever make more, where they make most of the rise."""
        at, best = end.nearest.evaluation, self._optimum
        n = n_prior_rows(self._problem)
        first = best.residuals.size - n
        rises = {
            EndOrigin.PRIOR: _rise(best, at, slice(first, first + n)),
            EndOrigin.LIMIT: _rise(best, at, limit_rows(self._problem)),
        }
        whole = at.deviance - best.deviance
        if not sum(max(x, 0.0) for x in rises.values()) > MOST * whole > 0.0:
            return EndOrigin.DATA
        return max(rises, key=rises.__getitem__)


def _rise(before: Evaluation, after: Evaluation, rows: slice) -> float:
    return sum_of_squares(after.residuals[rows]) - sum_of_squares(before.residuals[rows])
