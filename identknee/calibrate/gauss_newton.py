"""The Gauss-Newton step within bounds, and what it says about a point."""

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from identknee.calibrate.objective import half_sum_of_squares
from identknee.calibrate.scales import typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array

STEP_TOLERANCE = 1e-6
ROUNDING = 1e-14
# Singular values below this part of the largest one are rounding, not information.
RANK_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GaussNewton:
    """The best step within the bounds by the linear model of the residuals.

    Attributes
    ----------
    step
        To be added to theta, shape ``(n,)``.
    length
        Largest component of the step, in typical steps (3 kN, 2 %).
    reduction
        How much lower the linear model has the objective there.
    is_stationary
        Whether the step is below 1e-6 of the typical steps, or promises less than rounding.
    gradient_norm
        Largest derivative of the objective by a parameter, times its typical step, leaving out
        those that only lead out of the bounds.
    """

    step: Array
    length: float
    reduction: float
    is_stationary: bool
    gradient_norm: float


def gauss_newton(
    theta: Array, residuals: Array, jacobian: Array, parameters: Parameters
) -> GaussNewton:
    """The Gauss-Newton step at `theta`, parameters at a bound included.

    Parameters
    ----------
    theta
        Where, shape ``(n,)``, within the bounds.
    residuals, jacobian
        Finite residuals there, shape ``(m,)``, and their derivatives, shape ``(m, n)``.
    parameters
        For the bounds and the typical steps.
    """
    scales = typical_steps(parameters)
    scaled = jacobian * scales
    low, high = (parameters.lower - theta) / scales, (parameters.upper - theta) / scales
    solution = scipy.optimize.lsq_linear(
        *_condensed(scaled, -residuals),
        bounds=(np.minimum(low, 0.0), np.maximum(high, 0.0)),
        method="bvls",
    )
    step = np.asarray(solution.x, dtype=np.float64)
    change = scaled @ step
    gradient = scaled.T @ residuals
    reduction = float(-residuals @ change) - half_sum_of_squares(change)
    length = float(np.max(np.abs(step)))
    inward = np.where(gradient > 0, low < -STEP_TOLERANCE, high > STEP_TOLERANCE)
    return GaussNewton(
        step=scales * step,
        length=length,
        reduction=reduction,
        is_stationary=length < STEP_TOLERANCE
        or reduction <= ROUNDING * half_sum_of_squares(residuals),
        gradient_norm=float(np.max(np.abs(gradient) * inward)),
    )


def _condensed(matrix: Array, data: Array) -> tuple[Array, Array]:
    """A square system with the same least-squares solutions, and none where `matrix` has no say.

    Along directions that change nothing, which scipy would follow into rounding, it asks for zero.
    """
    n = matrix.shape[1]
    padded = np.vstack([matrix, np.zeros((n, n))])
    left, size, right = np.linalg.svd(padded, full_matrices=False)
    known = size > RANK_TOLERANCE * size[0]
    wanted = np.where(known, left[: len(data)].T @ data, 0.0)
    weights = np.where(known, size, max(float(size[0]), 1e-150))
    return weights[:, None] * right, wanted
