"""Bounded least squares with the exact Jacobian, which sees a cliff and steps around it."""

import numpy as np

from identknee.calibrate.cliff import way_around
from identknee.calibrate.constrained import minimise
from identknee.calibrate.evaluation import Ended, Evaluator
from identknee.calibrate.gauss_newton import gauss_newton
from identknee.calibrate.scales import typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

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
    springs 296 reach it, and 243 by the active set of `identknee.calibrate.constrained`, which is
    the method near a minimum and with a constraint. With nuisance parameters that method, which
    learns the curvature of their bent valleys, takes over where this one creeps. It ends where the
    Gauss-Newton step within the bounds vanishes, or where no step goes down any more and the
    derivatives promise next to nothing, as at a minimum on a kink (`minimum`). Where it cannot go
    on because every longer step has no prediction it tries to get around
    (`identknee.calibrate.cliff`) and goes on from there, or ends (`cliff`). A start outside the
    bounds is moved just inside.
    """
    theta = _inside(start, evaluator.parameters)
    if not np.isfinite(evaluator.deviance(theta)):
        return Outcome.START_FAILED
    for _ in range(MAX_WAYS):
        outcome = _descend(evaluator, theta)
        if outcome is not Outcome.CLIFF:
            return outcome
        around = way_around(evaluator, _best(evaluator), generator)
        if around is None:
            return Outcome.CLIFF
        theta = around
    return Outcome.CLIFF


def _descend(evaluator: Evaluator, theta: Array) -> Outcome:
    # Verbs that do not fit, but know what a fit is, start without it.
    import scipy.optimize

    parameters = evaluator.parameters
    theta = _strictly_inside(theta, parameters)
    if not np.isfinite(evaluator.deviance(theta)):
        return Outcome.CLIFF
    watch = _Watch(evaluator)
    # Only the step is left to scipy as a reason to stop: the others are tested in `_Watch`.
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
    except Ended as end:
        if end.outcome is Outcome.BUDGET:
            raise
        outcome = end.outcome
    else:
        outcome = Outcome.VALLEY
    if evaluator.curvature is not None:
        found = minimise(evaluator, _best(evaluator), most_steps=MOST_STEPS)
        if found.outcome is Outcome.BUDGET:
            raise Ended(Outcome.BUDGET)
        outcome = found.outcome
    if outcome is Outcome.VALLEY and _is_on_a_kink(evaluator):
        outcome = Outcome.MINIMUM
    if outcome is Outcome.MINIMUM:
        _settle(evaluator)
    return outcome


class _Watch:
    """Residuals and Jacobian for scipy, which leave its loop where it would waste simulations.

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
        self._stop_creeping()
        if self._accepted is not None and not np.all(np.isfinite(residuals)):
            step = np.max(np.abs(theta - self._accepted) / self._scales)
            if step < CLIFF_STEP:
                raise Ended(Outcome.CLIFF)
        return residuals

    def _stop_creeping(self) -> None:
        """End the search where its steps have long been too short to matter, as along a kink."""
        lowest = self._evaluator.best_deviance
        self._n_above_goal += 1
        if lowest < self._goal:
            self._goal, self._n_above_goal = (1.0 - self._creeping[1]) * lowest, 0
        if self._n_above_goal > self._creeping[0]:
            raise Ended(Outcome.VALLEY)

    def jacobian(self, theta: Array) -> Array:
        here = self._evaluator(theta)
        if not here.is_finite:
            raise Ended(Outcome.VALLEY)
        if gauss_newton(here, self._evaluator.parameters).is_stationary:
            raise Ended(Outcome.MINIMUM)
        self._accepted = here.theta
        return here.jacobian


def _is_on_a_kink(evaluator: Evaluator) -> bool:
    """Whether the derivatives promise next to nothing where the search could not go on.

    Where a contact point just touches, the derivatives of both sides differ and may point at each
    other: the lowest place is there, and no derivative vanishes at it.
    """
    here = evaluator(_best(evaluator))
    return here.is_finite and gauss_newton(here, evaluator.parameters).is_on_a_kink


def _settle(evaluator: Evaluator) -> None:
    """Take the last Gauss-Newton step, which ends on an active bound and not just before it."""
    theta = _best(evaluator)
    parameters = evaluator.parameters
    step = gauss_newton(evaluator(theta), parameters).step
    evaluator.deviance(np.clip(theta + step, parameters.lower, parameters.upper))


def _best(evaluator: Evaluator) -> Array:
    if evaluator.best_theta is None:  # pragma: no cover - only called after a finite start
        raise Ended(Outcome.START_FAILED)
    return evaluator.best_theta


def _inside(start: Array, parameters: Parameters) -> Array:
    margin = np.minimum(
        INSIDE * typical_steps(parameters), 0.1 * (parameters.upper - parameters.lower)
    )
    outside = (start <= parameters.lower) | (start >= parameters.upper)
    moved = np.clip(start, parameters.lower + margin, parameters.upper - margin)
    return np.where(outside, moved, start)


def _strictly_inside(theta: Array, parameters: Parameters) -> Array:
    # scipy moves a start on a bound by 1e-10 of it, which would be one more simulation.
    lower, upper = parameters.lower, parameters.upper
    return np.clip(
        theta,
        lower + RELATIVE_START * np.maximum(1.0, np.abs(lower)),
        upper - RELATIVE_START * np.maximum(1.0, np.abs(upper)),
    )
