"""Bounded least squares with the exact Jacobian, which sees a cliff and steps around it."""

import numpy as np
import scipy.optimize

from identknee.calibrate.cliff import way_around
from identknee.calibrate.gauss_newton import gauss_newton
from identknee.calibrate.objective import Ended, Objective
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
# Of the objective: what a step that cannot be made may promise at a minimum on a kink.
KINK_SHARE = 1e-6


def minimise_by_least_squares(
    objective: Objective, start: Array, generator: np.random.Generator
) -> Outcome:
    """How bounded least squares from `start` ended on `objective`.

    scipy's trust-region reflective method does the descent. It ends where the Gauss-Newton step
    within the bounds vanishes, or where no step goes down any more and none promises a millionth of
    the objective, as at a minimum on a kink (`minimum`). Where it cannot go on because every longer
    step has no prediction it tries to get around (`identknee.calibrate.cliff`) and goes on from
    there, or ends (`cliff`). A start outside the bounds is moved just inside.
    """
    theta = _inside(start, objective.parameters)
    if not np.isfinite(objective.value(theta)):
        return Outcome.START_FAILED
    for _ in range(MAX_WAYS):
        outcome = _descend(objective, theta)
        if outcome is not Outcome.CLIFF:
            return outcome
        around = way_around(objective, _best(objective), generator)
        if around is None:
            return Outcome.CLIFF
        theta = around
    return Outcome.CLIFF


def _descend(objective: Objective, theta: Array) -> Outcome:
    parameters = objective.parameters
    theta = _strictly_inside(theta, parameters)
    if not np.isfinite(objective.value(theta)):
        return Outcome.CLIFF
    watch = _Watch(objective)
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
            max_nfev=objective.budget + 1,
        )
    except Ended as end:
        if end.outcome is Outcome.BUDGET:
            raise
        outcome = end.outcome
    else:
        outcome = Outcome.MINIMUM if _is_on_a_kink(objective) else Outcome.VALLEY
    if outcome is Outcome.MINIMUM:
        _settle(objective)
    return outcome


class _Watch:
    """Residuals and Jacobian for scipy, which leave its loop where it would waste simulations.

    It asks for a Jacobian at each point it accepts and nowhere else. It shrinks its steps fourfold
    after residuals that are not finite, without an end to that.
    """

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._scales = typical_steps(objective.parameters)
        self._accepted: Array | None = None

    def residuals(self, theta: Array) -> Array:
        residuals = self._objective.residuals(theta)
        if self._accepted is not None and not np.all(np.isfinite(residuals)):
            step = np.max(np.abs(theta - self._accepted) / self._scales)
            if step < CLIFF_STEP:
                raise Ended(Outcome.CLIFF)
        return residuals

    def jacobian(self, theta: Array) -> Array:
        objective = self._objective
        residuals, jacobian = objective.residuals(theta), objective.jacobian(theta)
        if not np.all(np.isfinite(jacobian)):
            raise Ended(Outcome.VALLEY)
        if gauss_newton(theta, residuals, jacobian, objective.parameters).is_stationary:
            raise Ended(Outcome.MINIMUM)
        self._accepted = np.array(theta)
        return jacobian


def _is_on_a_kink(objective: Objective) -> bool:
    """Whether the derivatives promise next to nothing where the search could not go on.

    Where a contact point just touches, the derivatives of both sides differ and may point at each
    other: the lowest place is there, and no derivative vanishes at it.
    """
    theta = _best(objective)
    residuals, jacobian = objective.residuals(theta), objective.jacobian(theta)
    step = gauss_newton(theta, residuals, jacobian, objective.parameters)
    return bool(step.reduction <= KINK_SHARE * objective.value(theta))


def _settle(objective: Objective) -> None:
    """Take the last Gauss-Newton step, which ends on an active bound and not just before it."""
    theta = _best(objective)
    parameters = objective.parameters
    residuals, jacobian = objective.residuals(theta), objective.jacobian(theta)
    step = gauss_newton(theta, residuals, jacobian, parameters).step
    objective.value(np.clip(theta + step, parameters.lower, parameters.upper))


def _best(objective: Objective) -> Array:
    if objective.best_theta is None:  # pragma: no cover - only called after a finite start
        raise Ended(Outcome.START_FAILED)
    return objective.best_theta


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
