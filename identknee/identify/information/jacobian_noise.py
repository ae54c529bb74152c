"""How wrong a Jacobian is: by rounding, seen by perturbing, and at all, seen by differences."""

import numpy as np

from identknee.calibrate.evaluation import Evaluation, Evaluator
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry

# In scaled units. The perturbation must be small against any curvature and large against the
# rounding of theta; the steps are tried from long to short.
PERTURBATION = 1e-8
N_PERTURBATIONS = 8
STEPS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


@declared
class JacobianNoise:
    """Errors of the derivatives of m residuals by n scaled parameters."""

    rounding: float = entry(
        "Largest singular value of the change of the Jacobian under perturbations of theta of "
        "1e-8, linear change taken out: what the solver's tolerance and rounding do",
        unit="1",
    )
    errors: Array = array(
        "Differences of the residuals less the Jacobian, by the step that agrees best: bounds what "
        "is wrong with the Jacobian for any reason; zero in columns in which no step had a "
        "prediction",
        *("residual", "parameter"),
    )
    steps: Array = array(
        "Step of each column, in scaled units; NaN where none had a prediction", "parameter"
    )

    def floors(self, directions: Array) -> Array:
        """Square of the error along each of the unit `directions`, columns (n, k); ``(k,)``.

        An eigenvalue of the information below its floor may as well be zero.
        """
        along = np.linalg.norm(self.errors @ directions, axis=0)
        return np.asarray(np.maximum(along, self.rounding) ** 2)


def jacobian_noise(
    evaluator: Evaluator, at: Evaluation, scales: Array, *, seed: int = 0
) -> JacobianNoise:
    """The errors of the Jacobian at a point.

    Parameters
    ----------
    evaluator
        Evaluations of the problem.
    at
        The point, within the bounds, with a prediction.
    scales
        One scaled unit of each parameter, shape ``(n,)``.
    seed
        Seed of the perturbations.

    Raises
    ------
    ValueError
        If the point lies outside the bounds.
    """
    parameters = evaluator.parameters
    outside = np.flatnonzero((at.theta < parameters.lower) | (at.theta > parameters.upper))
    if outside.size:
        i = int(outside[0])
        raise ValueError(
            f"{parameters.names[i]} is {at.theta[i]:g}, outside its bounds "
            f"{parameters.lower[i]:g} to {parameters.upper[i]:g}; give a theta inside them"
        )
    columns = [_column(evaluator, at, scales, i) for i in range(at.theta.size)]
    return JacobianNoise(
        rounding=_rounding(evaluator, at, scales, np.random.default_rng(seed)),
        errors=np.stack([error for error, _ in columns], axis=1),
        steps=np.array([step for _, step in columns]),
    )


def _rounding(
    evaluator: Evaluator, at: Evaluation, scales: Array, generator: np.random.Generator
) -> float:
    """Largest singular value of the noise of the Jacobian, over the perturbations."""
    sizes = [0.0]
    parameters = evaluator.parameters
    for _ in range(N_PERTURBATIONS):
        move = PERTURBATION * scales * generator.choice([-1.0, 1.0], at.theta.size)
        # Where a bound is in the way the middle of the three points moves inward.
        middle = np.clip(at.theta, parameters.lower + abs(move), parameters.upper - abs(move))
        three = [evaluator(middle + sign * move) for sign in (-1.0, 0.0, 1.0)]
        if all(x.is_finite for x in three):
            low, here, high = (x.jacobian * scales for x in three)
            # The variance of independent errors in such a sum is 1 + 4 + 1 times theirs.
            noise = (low - 2.0 * here + high) / np.sqrt(6.0)
            sizes.append(float(np.linalg.norm(noise, 2)))
    return max(sizes)


def _column(evaluator: Evaluator, at: Evaluation, scales: Array, i: int) -> tuple[Array, float]:
    """Difference less derivative by one parameter, and the step where they agree best."""
    exact = at.jacobian[:, i] * scales[i]
    best, best_step = np.zeros(exact.size), np.nan
    for step in STEPS:
        slope = _difference(evaluator, at, i, step * scales[i])
        if slope is None:
            continue
        error = slope * scales[i] - exact
        if np.isnan(best_step) or np.linalg.norm(error) < np.linalg.norm(best):
            best, best_step = error, step
    return best, best_step


def _difference(evaluator: Evaluator, at: Evaluation, i: int, step: float) -> Array | None:
    """Fourth-order central difference; second-order to the inside where a bound is near."""
    parameters, place = evaluator.parameters, at.theta[i]
    room_below, room_above = place - parameters.lower[i], parameters.upper[i] - place

    def residuals(steps: float) -> Array:
        theta = np.array(at.theta)
        theta[i] += steps * step
        found = evaluator(theta)
        return found.residuals if found.is_finite else np.full(at.residuals.size, np.nan)

    if min(room_below, room_above) >= 2.0 * step:
        near, far = residuals(1.0) - residuals(-1.0), residuals(2.0) - residuals(-2.0)
        slope = (8.0 * near - far) / (12.0 * step)
    elif max(room_below, room_above) >= 2.0 * step:
        side = 1.0 if room_above > room_below else -1.0
        there = 4.0 * residuals(side) - residuals(2.0 * side)
        slope = (there - 3.0 * at.residuals) / (2.0 * side * step)
    else:
        return None
    return slope if np.isfinite(slope).all() else None
