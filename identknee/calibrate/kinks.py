"""The step that heeds what the derivatives say on both sides of a kink."""

import numpy as np

from identknee.calibrate.bounded_step import Step, bounded_step
from identknee.calibrate.curvature import Linearised
from identknee.runs.arrays import Array

# In conditional standard deviations: a longer step is no end of a search. In lengths of that step:
# a point farther away says nothing of a kink that it leads across.
LONGEST, NEARBY = 2.0, 2.0
# How many points are remembered.
REMEMBERED = 12
# How often the shares of two models are exchanged, and halvings of each exchange.
MOST_EXCHANGES, MOST_HALVINGS = 12, 40


class Kinks:
    """What one search knows of kinks near the point where it is.

    Where a contact begins or ends, the derivatives of the residuals jump. At a minimum on such a
    kink those of either side promise a decrease on the other, so that steps by one of them zigzag
    and shrink. The highest of the linear models of both sides has its minimum on the kink.

    References
    ----------
    K. C. Kiwiel, Methods of Descent for Nondifferentiable Optimization (1985), chapter 2,
    doi:10.1007/BFb0074500.
    """

    def __init__(self) -> None:
        self._points: list[Linearised] = []

    @property
    def is_met(self) -> bool:
        """Whether any step did not keep its promise."""
        return bool(self._points)

    def remember(self, point: Linearised) -> None:
        """Take in a point from which, or to which, a step did not keep its promise."""
        self._points = [point, *self._points[: REMEMBERED - 1]]

    def models(self, at: Linearised, scales: Array, *, length: float, slack: float) -> Array:
        """Linear models of the residuals around a point, its own first, ``(k, n + 1, n + 1)``.

        Each is a triangle whose product with a step, in parameters divided by `scales`, and a one
        has the model's deviance as its sum of squares. Of the points remembered those count that
        lie about as near as the step leads and whose model has the deviance at `at` no higher than
        it is: between them and `at` the deviance bends upward. None does where the step is long.

        Parameters
        ----------
        at
            Residuals and derivatives around which steps are planned.
        scales
            Conditional standard deviations, shape ``(n,)``.
        length
            Largest component of the step that the own model leads to, in these.
        slack
            How much higher than it is another model may have the deviance at `at`, as from a point
            that is not quite on a kink.
        """
        most = float(at.residuals @ at.residuals) + slack
        models = [_triangle(at, at, scales)]
        for point in self._points if length <= LONGEST else ():
            apart = np.max(np.abs(point.theta - at.theta) / scales)
            if 0.0 < apart <= NEARBY * length:
                model = _triangle(point, at, scales)
                if float(np.sum(model[:, -1] ** 2)) <= most:
                    models.append(model)
        return np.array(models)


def lowest_of_the_highest(
    models: Array, box: tuple[Array, Array], constraint: tuple[Array, float] | None, gap: float
) -> tuple[Step, float]:
    """The step to where the highest of several models is lowest, and the deviance there.

    It is found through its dual: a weighted sum of the models whose minimum is as high as can be.
    That sum also has the multiplier of the constraint on the kink.

    Parameters
    ----------
    models
        From `Kinks.models`.
    box, constraint
        As for `identknee.calibrate.bounded_step.bounded_step`.
    gap
        How far below the height of the step the deviance returned may be.
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
