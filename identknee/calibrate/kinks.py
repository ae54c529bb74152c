"""The step that heeds what the derivatives say on both sides of a kink."""

from collections.abc import Sequence

import numpy as np

from identknee.calibrate.bounded_step import Step, bounded_step
from identknee.calibrate.curvature import Linearised
from identknee.runs.arrays import Array

# In conditional standard deviations: a longer step is no end of a search. In lengths of that step:
# a point farther away says nothing of a kink that it leads across.
LONGEST, NEARBY = 1.0, 4.0
# How often the shares of two models are exchanged, and halvings of each exchange.
MOST_EXCHANGES, MOST_HALVINGS = 12, 12


def models_around(
    at: Linearised, others: Sequence[Linearised], scales: Array, length: float
) -> Array:
    """Linear models of the residuals around a point, its own first, shape ``(k, n + 1, n + 1)``.

    Each is a triangle whose product with a step, in parameters divided by `scales`, and a one has
    the model's deviance as its sum of squares. Of the other points those count that lie about as
    near as the step leads and whose model has the deviance at `at` no higher than it is: between
    them and `at` the deviance bends upward. None does where the step is long.

    Parameters
    ----------
    at
        Residuals and derivatives around which steps are planned.
    others
        Those of other points.
    scales
        Conditional standard deviations, shape ``(n,)``.
    length
        Largest component of the step that the own model leads to, in these.
    """
    deviance = float(at.residuals @ at.residuals)
    models = [_triangle(at, at, scales)]
    for other in others:
        apart = np.max(np.abs(other.theta - at.theta) / scales)
        if 0.0 < apart <= NEARBY * length and length <= LONGEST:
            model = _triangle(other, at, scales)
            if float(np.sum(model[:, -1] ** 2)) <= deviance:
                models.append(model)
    return np.array(models)


def lowest_of_the_highest(
    models: Array, box: tuple[Array, Array], constraint: tuple[Array, float] | None, gap: float
) -> tuple[Step, float]:
    """The step to where the highest of several models is lowest, and the deviance there.

    Where a contact begins or ends, the derivatives of the residuals jump. At a minimum on such a
    kink those of either side promise a decrease on the other, so that steps by one of them zigzag
    and shrink; the highest of the models of both sides has its minimum on the kink. It is found
    through its dual: a weighted sum of the models whose minimum is as high as can be. That sum also
    has the multiplier of the constraint on the kink.

    Parameters
    ----------
    models
        From `models_around`.
    box, constraint
        As for `identknee.calibrate.bounded_step.bounded_step`.
    gap
        How far below the height of the step the deviance returned may be.

    References
    ----------
    K. C. Kiwiel, Methods of Descent for Nondifferentiable Optimization (1985), chapter 2,
    doi:10.1007/BFb0074500.
    """
    weights = np.zeros(len(models))
    weights[0] = 1.0
    step, heights = _lowest(models, weights, box, constraint)
    for _ in range(MOST_EXCHANGES):
        highest = int(np.argmax(heights))
        if heights[highest] - weights @ heights <= gap:
            break
        lowest = int(np.argmin(np.where(weights > 0.0, heights, np.inf)))
        exchange = np.zeros(len(models))
        exchange[[lowest, highest]] = -weights[lowest], weights[lowest]
        low, high, share = 0.0, 1.0, 1.0
        for _ in range(MOST_HALVINGS):
            _, tried = _lowest(models, weights + share * exchange, box, constraint)
            slope = float(exchange @ tried)
            if abs(slope) <= gap or (share == 1.0 and slope > 0.0):
                break
            low, high = (share, high) if slope > 0.0 else (low, share)
            share = 0.5 * (low + high)
        weights = np.maximum(weights + share * exchange, 0.0)
        step, heights = _lowest(models, weights, box, constraint)
    return step, float(weights @ heights)


def _lowest(
    models: Array, weights: Array, box: tuple[Array, Array], constraint: tuple[Array, float] | None
) -> tuple[Step, Array]:
    """The step to the minimum of a weighted sum of models, and how high each is there, ``(k,)``."""
    used = weights > 0.0
    rows = np.concatenate(np.sqrt(weights[used])[:, None, None] * models[used])
    step = bounded_step(rows[:, :-1], rows[:, -1], box, constraint)
    return step, np.sum((models @ np.append(step.step, 1.0)) ** 2, axis=1)


def _triangle(of: Linearised, at: Linearised, scales: Array) -> Array:
    """The linear model of one point around another, shape ``(n + 1, n + 1)``."""
    data = of.residuals + of.jacobian @ (at.theta - of.theta)
    rows = np.column_stack([of.jacobian * scales, data])
    padded = np.vstack([rows, np.zeros((max(rows.shape[1] - len(rows), 0), rows.shape[1]))])
    return np.asarray(np.linalg.qr(padded, mode="r"))
