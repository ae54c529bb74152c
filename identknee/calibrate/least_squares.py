"""Bounded least squares from far away: scipy's trust-region reflective descent, around cliffs.

1. Step: in the interior of the bounds, ``(J'J + C) d = -J'r`` in variables scaled by the distance
   to the bounds that the gradient points at, within a trust region and reflected at bounds [1]_.
2. Active bounds: none before the end, when one Gauss-Newton step within the bounds puts the
   parameters on them (`gauss_newton`).
3. Cliffs: where every longer step has no prediction, points are tried in coordinates in which the
   linear model is a distance, ``|y - y*|^2`` with ``J = U S V'``, ``y = S V' d`` and
   ``y* = -U'r``: along single components of y*, then along y* tilted to the side
   (`descent_around_cliff`).
4. Stopping: at a minimum the Gauss-Newton step within the bounds vanishes or predicts less than
   rounding, ``-2 r'J d - |J d|^2``; on a kink no step goes down and it predicts next to nothing.

Unlike `identknee.calibrate.bounded_least_squares` it keeps away from the bounds during the search,
and so reaches the minimum from far away more often (see `minimise_by_least_squares` for counts).

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
from identknee.runs.declare import Array, declared, entry
from identknee.runs.record import Outcome

STEP_TOLERANCE = 1e-6
ROUNDING = 1e-14


@declared
class GaussNewton:
    """The best step within the bounds by the linear model of the residuals."""

    step: Array = entry("The step of theta, shape ``(n,)``")
    length: float = entry("Largest component of the step, in typical steps (3 kN, 2 %)")
    reduction: float = entry("Reduction of the deviance that the linear model predicts")
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
    """The Gauss-Newton step from an evaluation within the bounds of the parameters."""
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
    the components of the step to the target are tried one by one: where stiff and soft directions
    are mixed, some of them often stay off the cliff. If all meet it, the step is tilted towards
    each direction orthogonal to it, and then away from the directions that met the cliff, which
    moves along it.

    Parameters
    ----------
    evaluator
        Evaluator of the residuals; it has a prediction at `theta`.
    theta
        A point before a cliff, shape ``(n,)``, within the bounds.
    generator
        Rotates the orthogonal directions at random, so that a second attempt differs.
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
    """Steps tried from one point, in coordinates in which the linear model is a distance."""

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


# Distance to a cliff at which a search stops, and distance of a start from the bounds, in typical
# steps (3 kN, 2 %).
CLIFF_STEP = 1e-4
INSIDE = 1e-3
# scipy's tolerance on a step, and distance of its start from the bounds, relative to theta.
RELATIVE_STEP = 1e-10
RELATIVE_START = 1e-9
# Most descents after a way around a cliff, and most steps of a search with curvature.
MAX_WAYS = 30
MOST_STEPS = 200
# A search ends if so many simulations lower the deviance by less than this share of it. The second
# pair ends it earlier where a search that estimates the curvature takes over.
CREEPING, A_CREEP = 40, 1e-5
CREEPING_SOON, A_CREEP_SOON = 6, 1e-2


def minimise_by_least_squares(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How bounded least squares from `start` ended.

    The descent is scipy's trust-region reflective method. It stays off the bounds, which a slack
    ligament could not leave again because it has no derivatives: of 300 starts far from the minimum
    of eight sloppy springs 296 reach it, against 243 by the active set of
    `identknee.calibrate.bounded_least_squares`, which is the method near a minimum and with a
    constraint. With nuisance parameters the latter takes over when the descent becomes slow,
    because it estimates the curvature of their bent valleys.

    A search ends as a minimum if the Gauss-Newton step within the bounds vanishes, or if no step
    lowers the deviance and the derivatives predict next to no reduction, as on a kink. If every
    longer step has no prediction, a way around that cliff is tried, and the search ends as a cliff
    if there is none. With nuisances no way around is tried: it takes hundreds of simulations, and a
    search from another start one hundred. A start outside the bounds is moved just inside.
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
    # Imported here, so that verbs without a fit start faster.
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
    # scipy stops by the size of its step only; `_Monitored` tests all other criteria.
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
            # The budget of the evaluator ends the search.
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

    scipy asks for a Jacobian only at points that it accepts. It shortens its step fourfold whenever
    residuals are not finite, without limit.
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
