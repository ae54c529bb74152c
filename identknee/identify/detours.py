"""Ways around places where a model has no prediction: fits begun at other points nearby."""

import numpy as np

from identknee.calibrate.bounded_step import bounded_step
from identknee.calibrate.constrained import (
    Constrained,
    minimise,
    solve_constrained,
)
from identknee.calibrate.evaluation import Ended, Evaluation, Evaluator
from identknee.calibrate.quantity import Quantity
from identknee.calibrate.scales import conditional_sds
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

# Points tried until one has a prediction, and fits made from those that have one.
N_TRIED = 48
N_FITS = 2
MOST_STEPS = 24
# Seed of the directions in which points are tried: the same ones every time.
SEED = 20
# Directions that the data hardly see are gone along for no more than the inverse of this, in
# conditional standard deviations.
LEAST_SIZE = 0.05


def fit_around(
    evaluator: Evaluator,
    at: Evaluation,
    *,
    quantity: Quantity | None,
    target: float,
    rise: float,
    tolerance: float,
) -> Constrained | None:
    """The lowest fit found from points around `at`, None where none of them has a prediction.

    The points lie where the linear model expects the deviance to rise by no more than `rise` above
    its lowest on the plane of the target, nearest first. The first fit that ends at a minimum is
    taken; one that stops at the feasibility boundary is tried again from one other point.

    Parameters
    ----------
    evaluator
        Evaluator of residuals in units of their noise.
    at
        A simulation with a prediction.
    quantity, target
        What is held, and at what value; `target` means nothing where `quantity` is None.
    rise
        Rise of the deviance up to which points are tried.
    tolerance
        Tolerance on the deviance, as for `solve_constrained`.
    """
    best: Constrained | None = None
    n_fits = 0
    for theta in _points_around(evaluator, at, quantity, target, rise):
        try:
            if not evaluator(theta).is_finite:
                continue
        except Ended:
            return best
        if quantity is None:
            end = minimise(evaluator, theta, tolerance=tolerance, most_steps=MOST_STEPS)
        else:
            end = solve_constrained(
                evaluator,
                theta,
                quantity=quantity,
                target=target,
                tolerance=tolerance,
                most_steps=MOST_STEPS,
            )
        n_fits += 1
        arrived = quantity is None or end.is_on_target
        if arrived and (best is None or end.evaluation.deviance < best.evaluation.deviance):
            best = end
        if n_fits == N_FITS or (arrived and end.outcome is Outcome.MINIMUM):
            break
    return best


def promised_reduction(evaluator: Evaluator, at: Evaluation, gradient: Array | None) -> float:
    """How much lower the deviance could be by the linear model, had every point a prediction.

    Parameters
    ----------
    evaluator
        Evaluator of the residuals; its parameters' bounds are kept.
    at
        The simulation from which the model is linear.
    gradient
        Gradient of what is held, shape ``(n,)``; None where nothing is.
    """
    scales, bounds = _scaled_room(evaluator, at)
    matrix = at.jacobian * scales
    plane = None if gradient is None else (gradient * scales, 0.0)
    change = matrix @ bounded_step(matrix, at.residuals, bounds, plane).step
    return float(-2.0 * at.residuals @ change - change @ change)


def _scaled_room(evaluator: Evaluator, at: Evaluation) -> tuple[Array, tuple[Array, Array]]:
    parameters = evaluator.parameters
    scales = conditional_sds(at.jacobian, parameters)
    return scales, ((parameters.lower - at.theta) / scales, (parameters.upper - at.theta) / scales)


def _points_around(
    evaluator: Evaluator, at: Evaluation, quantity: Quantity | None, target: float, rise: float
) -> Array:
    """Points on the plane of the target, nearest its lowest first, shape ``(N_TRIED, n)``."""
    parameters = evaluator.parameters
    scales, bounds = _scaled_room(evaluator, at)
    matrix = at.jacobian * scales
    basis, plane = np.eye(parameters.n), None
    if quantity is not None:
        value, gradient = quantity.evaluate(at.theta)
        normal = gradient * scales
        if normal.any():
            plane = normal, target - value
            basis = np.linalg.qr(normal[:, None], mode="complete")[0][:, 1:]
    center = bounded_step(matrix, at.residuals, bounds, plane).step
    _, sizes, directions = np.linalg.svd(
        np.vstack([matrix @ basis, np.zeros((basis.shape[1], basis.shape[1]))]),
        full_matrices=False,
    )
    spread = basis @ (directions.T / np.maximum(sizes, LEAST_SIZE))
    draws = np.random.default_rng(SEED).standard_normal((N_TRIED, basis.shape[1]))
    draws /= np.maximum(np.linalg.norm(draws, axis=1, keepdims=True), 1e-300)
    radii = np.sqrt(rise * np.arange(N_TRIED) / N_TRIED)
    steps = center + radii[:, None] * (draws @ spread.T)
    points: Array = np.clip(at.theta + scales * steps, parameters.lower, parameters.upper)
    return points
