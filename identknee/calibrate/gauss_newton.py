"""The Gauss-Newton step within bounds, and what it says about a point."""

import numpy as np

from identknee.calibrate.bounded_step import bounded_step
from identknee.calibrate.evaluation import Evaluation
from identknee.calibrate.scales import typical_steps
from identknee.calibrate.tolerances import KINK_DEVIANCE, KINK_SHARE
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared

STEP_TOLERANCE = 1e-6
ROUNDING = 1e-14


@declared
class GaussNewton:
    """The best step within the bounds by the linear model of the residuals.

    Attributes
    ----------
    step
        To be added to theta, shape ``(n,)``.
    length
        Largest component of the step, in typical steps (3 kN, 2 %).
    reduction
        How much lower the linear model has the deviance there.
    is_on_a_kink
        Whether the reduction is so small that a search which cannot go on is at a minimum where the
        derivatives of both sides point at each other.
    is_stationary
        Whether the step is below 1e-6 of the typical steps, or promises less than rounding.
    gradient_norm
        Largest derivative of the deviance by a parameter, times its typical step, leaving out
        those that only lead out of the bounds.
    """

    step: Array
    length: float
    reduction: float
    is_on_a_kink: bool
    is_stationary: bool
    gradient_norm: float


def gauss_newton(here: Evaluation, parameters: Parameters) -> GaussNewton:
    """The Gauss-Newton step from an evaluation, parameters at a bound included.

    Parameters
    ----------
    here
        A simulation with a prediction, within the bounds.
    parameters
        For the bounds and the typical steps.
    """
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
