"""Bounded least squares from far away: scipy's trust-region reflective descent, around cliffs.

1. Step: in the interior of the bounds, ``(J'J + C) d = -J'r`` in variables scaled by the distance
   to the bounds that the gradient points at, within a trust region and reflected at bounds [1]_.
2. Active bounds: none before the end, when one Gauss-Newton step within the bounds puts the
   parameters on them (`gauss_newton`).
3. Cliffs: where every longer step has no prediction, points are tried in coordinates in which the
   linear model is a distance, ``|y - y*|^2`` with ``J = U S V'``, ``y = S V' d`` and
   ``y* = -U'r``: along single components of y*, then along y* tilted sideways
   (`descent_around_cliff`).
4. Stopping: at a minimum the Gauss-Newton step within the bounds vanishes or predicts less than
   rounding, ``-2 r'J d - |J d|^2``; on a kink no step goes down and it predicts next to nothing.

It exists beside `identknee.calibrate.bounded_least_squares` because it stays off the bounds on the
way: far from the minimum it arrives more often (`minimise_by_least_squares` has the counts).

References
----------
.. [1] M. A. Branch, T. F. Coleman and Y. Li, A subspace, interior, and conjugate gradient method
       for large-scale bound-constrained minimization problems, SIAM J. Sci. Comput. 21 (1999) 1-23,
       doi:10.1137/S1064827595289108.
"""

import numpy as np
import scipy.linalg

from identknee.calibrate.bounded_least_squares import bounded_step, minimise
from identknee.calibrate.problem import (
    KINK_DEVIANCE,
    KINK_SHARE,
    RANK_TOLERANCE,
    Evaluation,
    Evaluator,
    SearchEnded,
    thin_svd,
    typical_steps,
)
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.record import Outcome

STEP_TOLERANCE = 1e-6
ROUNDING = 1e-14


@declared
class GaussNewton:
    """The best step within the bounds by the linear model of the residuals."""

    step: Array = entry("To be added to theta, shape ``(n,)``")
    length: float = entry("Largest component of the step, in typical steps (3 kN, 2 %)")
    reduction: float = entry("How much lower the linear model has the deviance there")
    is_on_a_kink: bool = entry(
        "Whether the reduction is so small that a search which cannot go on is at a minimum "
        "where the derivatives of both sides point at each other"
    )
    is_stationary: bool = entry(
        "Whether the step is below 1e-6 of the typical steps, or predicts less than rounding"
    )
    gradient_norm: float = entry(
        "Largest derivative of the deviance by a parameter, times its typical step, leaving out "
        "those that only lead out of the bounds"
    )


def gauss_newton(here: Evaluation, parameters: Parameters) -> GaussNewton:
    """The Gauss-Newton step from an evaluation, parameters at a bound included."""
    scales = typical_steps(parameters)
    scaled = here.jacobian * scales
    low, high = (parameters.lower - here.theta) / scales, (parameters.upper - here.theta) / scales
    bounds = np.minimum(low, 0.0), np.maximum(high, 0.0)
    step = bounded_step(scaled, here.residuals, bounds, None).step
    change = scaled @ step
    gradient = 2.0 * scaled.T @ here.residuals
    reduction = float(-2.0 * here.residuals @ change - change @ change)
    length = float(np.max(np.abs(step)))
    least = 0.0 if parameters.is_of_interest.all() else KINK_DEVIANCE
    inward = np.where(gradient > 0, low < -STEP_TOLERANCE, high > STEP_TOLERANCE)
    return GaussNewton(
        step=scales * step,
        length=length,
        reduction=reduction,
        is_on_a_kink=reduction <= max(KINK_SHARE * here.deviance, least),
        is_stationary=length < STEP_TOLERANCE or reduction <= ROUNDING * here.deviance,
        gradient_norm=float(np.max(np.abs(gradient) * inward)),
    )


LENGTHS = (1.0, 1 / 4, 1 / 16, 1 / 64)
LONGEST = 5.0
TILTS_DEG = (50.0, 75.0, 85.0)
TILTED_LENGTHS = (1.0, 0.1, 0.01)
# Least share of the decrease that the linear model, which sees no cliff, predicts.
ENOUGH = 0.01


def descent_around_cliff(
    evaluator: Evaluator, theta: Array, generator: np.random.Generator
) -> Array | None:
    """A feasible point clearly lower than `theta`, shape ``(n,)``; None if there is none.

    The singular vectors of the Jacobian turn the deviance into the distance from a target. First
    the components of the way to the target are tried one by one: where stiff and soft directions
    are mixed, often some of them are free. If all are blocked, the way itself is tilted sideways,
    along each of the directions across it and then away from those that were blocked, which
    slides along the cliff.

    Parameters
    ----------
    evaluator
        Evaluator of the residuals; it has a prediction at `theta`.
    theta
        A point before a cliff, shape ``(n,)``, within the bounds.
    generator
        Turns the sideways directions, so that a second try differs from the first.
    """
    poll = _Poll(evaluator, theta)
    if poll.distance == 0.0:
        return None
    for length in LENGTHS:
        steps = length * np.diag(poll.target)
        lower = poll.lowest(steps[np.argsort(-np.abs(poll.target))])
        if lower is not None:
            return lower
    # Orthonormal directions orthogonal to the target, as rows, randomly rotated.
    basis = scipy.linalg.null_space(poll.target[None])
    turn, _ = np.linalg.qr(generator.standard_normal((basis.shape[1], basis.shape[1])))
    across = np.asarray((basis @ turn).T)
    for length in TILTED_LENGTHS:
        for tilt in np.deg2rad(TILTS_DEG):
            lower = _search_tilted(poll, across, float(tilt), length)
            if lower is not None:
                return lower
    return None


class _Poll:
    """Trial steps from one point, in coordinates in which the linear model is a distance."""

    def __init__(self, evaluator: Evaluator, theta: Array) -> None:
        self._evaluator = evaluator
        self._theta = theta
        self._scales = typical_steps(evaluator.parameters)
        here = evaluator(theta)
        left, size, right = thin_svd(here.jacobian * self._scales)
        kept = size > RANK_TOLERANCE * size[0]
        self._scaled_from_poll = right[kept].T / size[kept]
        self._deviance = here.deviance
        self.target: Array = -(left[:, kept].T @ here.residuals)
        self.distance = float(np.linalg.norm(self.target))

    def lowest(self, steps: Array) -> Array | None:
        """The lowest point after any of the `steps`; None if none is low enough."""
        deviance, point = min([self.after(step) for step in steps], key=lambda pair: pair[0])
        return point if self.is_lower(deviance) else None

    def after(self, step: Array) -> tuple[float, Array]:
        """Deviance after `step`, and the point, kept to bounds and to moderate lengths."""
        scaled = self._scaled_from_poll @ step
        length = float(np.max(np.abs(scaled)))
        parameters = self._evaluator.parameters
        point = np.clip(
            self._theta + self._scales * scaled * min(1.0, LONGEST / max(length, LONGEST)),
            parameters.lower,
            parameters.upper,
        )
        return self._evaluator.deviance(point), point

    def is_lower(self, deviance: float) -> bool:
        """Whether the decrease is worth the step."""
        return deviance < self._deviance - ENOUGH * self.distance**2


def _search_tilted(poll: _Poll, across: Array, tilt: float, length: float) -> Array | None:
    """The lowest point along directions tilted from the target by an angle [rad]."""
    toward = np.cos(tilt) * poll.target
    sideways = np.sin(tilt) * poll.distance
    reach = length * np.cos(tilt)
    blocked = np.zeros(poll.target.size)
    for direction in np.vstack([across, -across]):
        deviance, point = poll.after(reach * (toward + sideways * direction))
        if poll.is_lower(deviance):
            return point
        blocked += direction * (not np.isfinite(deviance))
    if not blocked.any():
        return None
    away = -blocked / np.linalg.norm(blocked)
    return poll.lowest((reach * (toward + sideways * away))[None])


# Parts of the typical steps (3 kN, 2 %): how close to a cliff is close enough, and how far inside
# the bounds to start.
CLIFF_STEP = 1e-4
INSIDE = 1e-3
RELATIVE_STEP = 1e-10
RELATIVE_START = 1e-9
MAX_WAYS = 30
MOST_STEPS = 200
# A search creeps when so many simulations lower the deviance by less than this share of it: one to
# the end, and one that a search which learns curvature takes over.
CREEPING, A_CREEP = 40, 1e-5
CREEPING_SOON, A_CREEP_SOON = 6, 1e-2


def minimise_by_least_squares(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How bounded least squares from `start` ended.

    scipy's trust-region reflective method does the descent. It stays off the bounds, where a slack
    ligament has no slope to leave them by: of 300 starts far from the minimum of eight sloppy
    springs 296 reach it, and 243 by the active set of
    `identknee.calibrate.bounded_least_squares`, which is the method near a minimum and with a
    constraint. With nuisance parameters that method, which
    learns the curvature of their bent valleys, takes over where this one creeps. It ends where the
    Gauss-Newton step within the bounds vanishes, or where no step goes down any more and the
    derivatives predict next to nothing, as at a minimum on a kink (`minimum`). Where it cannot go
    on because every longer step has no prediction it tries to get around and goes on
    from there, or ends (`cliff`). Among nuisances it ends there at once: a way around takes
    hundreds of simulations, a search from elsewhere one hundred. A start outside the bounds is
    moved just inside.
    """
    lower, upper = evaluator.parameters.lower, evaluator.parameters.upper
    margin = np.minimum(INSIDE * typical_steps(evaluator.parameters), 0.1 * (upper - lower))
    moved = np.clip(start, lower + margin, upper - margin)
    theta = np.where((start <= lower) | (start >= upper), moved, start)
    if not np.isfinite(evaluator.deviance(theta)):
        return Outcome.START_FAILED
    for _ in range(MAX_WAYS):
        outcome = _descend(evaluator, theta)
        if outcome is not Outcome.CLIFF or evaluator.curvature is not None:
            return outcome
        around = descent_around_cliff(evaluator, _best(evaluator), generator)
        if around is None:
            return Outcome.CLIFF
        theta = around
    return Outcome.CLIFF


def _descend(evaluator: Evaluator, theta: Array) -> Outcome:
    # Verbs that do not fit, but know what a fit is, start without it.
    import scipy.optimize

    parameters = evaluator.parameters
    # scipy moves a start on a bound by 1e-10 of it, which would be one more simulation.
    lower, upper = parameters.lower, parameters.upper
    theta = np.clip(
        theta,
        lower + RELATIVE_START * np.maximum(1.0, np.abs(lower)),
        upper - RELATIVE_START * np.maximum(1.0, np.abs(upper)),
    )
    if not np.isfinite(evaluator.deviance(theta)):
        return Outcome.CLIFF
    watch = _Monitored(evaluator)
    # Only the step is left to scipy as a reason to stop: the others are tested in `_Monitored`.
    try:
        scipy.optimize.least_squares(
            watch.residuals,
            theta,
            jac=watch.jacobian,
            bounds=(parameters.lower, parameters.upper),
            method="trf",
            x_scale=typical_steps(parameters),
            ftol=None,
            xtol=RELATIVE_STEP,
            gtol=None,
            # The budget of the evaluator ends it.
            max_nfev=np.iinfo(np.int32).max,
        )
    except SearchEnded as end:
        if end.outcome is Outcome.BUDGET:
            raise
        outcome = end.outcome
    else:
        outcome = Outcome.VALLEY
    if evaluator.curvature is not None:
        found = minimise(evaluator, _best(evaluator), most_steps=MOST_STEPS)
        if found.outcome is Outcome.BUDGET:
            raise SearchEnded(Outcome.BUDGET)
        outcome = found.outcome
    best = _best(evaluator)
    if outcome in {Outcome.VALLEY, Outcome.MINIMUM} and (here := evaluator(best)).is_finite:
        newton = gauss_newton(here, parameters)
        # Where a contact point just touches, the derivatives of both sides differ and may point at
        # each other: the lowest place is there, and no derivative vanishes at it.
        if outcome is Outcome.MINIMUM or newton.is_on_a_kink:
            # A last step, which ends on the active bound, not just before it.
            evaluator.deviance(np.clip(best + newton.step, lower, upper))
            return Outcome.MINIMUM
    return outcome


class _Monitored:
    """Residuals and Jacobian for scipy, which end its loop when it stagnates.

    It asks for a Jacobian at each point it accepts and nowhere else. It shrinks its steps fourfold
    after residuals that are not finite, without an end to that.
    """

    def __init__(self, evaluator: Evaluator) -> None:
        self._evaluator = evaluator
        self._scales = typical_steps(evaluator.parameters)
        self._accepted: Array | None = None
        self._goal, self._n_above_goal = np.inf, 0
        is_followed = evaluator.curvature is not None
        self._creeping = (CREEPING_SOON, A_CREEP_SOON) if is_followed else (CREEPING, A_CREEP)

    def residuals(self, theta: Array) -> Array:
        residuals = self._evaluator.residuals(theta)
        # End the search when its steps stay negligibly short, as along a kink.
        lowest = self._evaluator.best_deviance
        self._n_above_goal += 1
        if lowest < self._goal:
            self._goal, self._n_above_goal = (1.0 - self._creeping[1]) * lowest, 0
        if self._n_above_goal > self._creeping[0]:
            raise SearchEnded(Outcome.VALLEY)
        if self._accepted is not None and not np.all(np.isfinite(residuals)):
            step = np.max(np.abs(theta - self._accepted) / self._scales)
            if step < CLIFF_STEP:
                raise SearchEnded(Outcome.CLIFF)
        return residuals

    def jacobian(self, theta: Array) -> Array:
        here = self._evaluator(theta)
        if not here.is_finite:
            raise SearchEnded(Outcome.VALLEY)
        if gauss_newton(here, self._evaluator.parameters).is_stationary:
            raise SearchEnded(Outcome.MINIMUM)
        self._accepted = here.theta
        return here.jacobian


def _best(evaluator: Evaluator) -> Array:
    if evaluator.best_theta is None:  # pragma: no cover - only called after a finite start
        raise SearchEnded(Outcome.START_FAILED)
    return evaluator.best_theta
