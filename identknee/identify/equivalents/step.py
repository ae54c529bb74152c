"""The farthest step that a Gauss-Newton model of a region allows."""

from dataclasses import dataclass

import numpy as np

from identknee.identify.equivalents.region import Blocks
from identknee.runs.arrays import Array

# Of the best step's value, normalised to about 1.
GAP = 1e-10
SHRINK = 0.03
MARGIN = 1e-3
FIRST_EXCESS = 0.01
MAX_NEWTON = 40
NEWTON_DECREMENT = 1e-2
HALVINGS = 40
ARMIJO = 0.1
ROUNDING = 1e-15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """The best step of a model.

    Attributes
    ----------
    step
        Shape ``(n,)``.
    excess
        How much the limit of 1 had to be raised for it, about 0 where the model's region is not
        empty.
    multipliers
        By how much the best gain grows with the limit of each block, shape ``(n_blocks,)``.
    """

    step: Array
    excess: float
    multipliers: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Model:
    """What a search knows around a point, in the units of its steps.

    Attributes
    ----------
    gain
        Derivatives of the quantity, shape ``(n,)``, of such a size that the best step's gain is
        about 1.
    blocks
        The region's blocks, finite.
    low, high
        Bounds of the step, shape ``(n,)``, with ``low < high`` and 0 between them.
    """

    gain: Array
    blocks: Blocks
    low: Array
    high: Array


def best_step(model: Model, *, penalty: float) -> Step:
    """The step of largest gain, less `penalty` times the excess, in a model.

    It keeps to ``|offsets[b] + slopes[b] @ step|^2 <= 1 + excess`` for every block, to the model's
    bounds and to ``excess >= 0``: a convex problem with an interior whatever the blocks are. It is
    solved by Newton's method on logarithmic barriers, which takes no notice of how sloppy the
    blocks are.

    Parameters
    ----------
    model
        What to maximise, and where.
    penalty
        Price of an excess; large enough, and there is none unless the model's region is empty.

    References
    ----------
    S. Boyd and L. Vandenberghe, Convex Optimization, Cambridge University Press 2004, section
    11.3.
    """
    barrier = _Barrier(model, penalty)
    room = MARGIN * (model.high - model.low)
    step = np.clip(np.zeros_like(model.low), model.low + room, model.high - room)
    excess = FIRST_EXCESS + 1.5 * max(float(barrier.values(step).max()) - 1.0, 0.0)
    point = np.append(step, excess)
    # As much as there is to gain: Newton's method is slow where the barriers count for little.
    weight = max(1.0, penalty * excess)
    while weight * barrier.n_constraints > GAP:
        weight *= SHRINK
        point = barrier.lowest(point, weight)
    step, excess = point[:-1], float(point[-1])
    multipliers = weight / (1.0 + excess - barrier.values(step))
    return Step(step=step, excess=excess, multipliers=multipliers)


class _Barrier:
    """Cost and logarithmic barriers at (step, excess)."""

    def __init__(self, model: Model, penalty: float) -> None:
        self._cost = np.r_[-model.gain, penalty]
        self._offsets, self._slopes = model.blocks.offsets, model.blocks.slopes
        self._curvature = 2.0 * np.einsum("bki,bkj->bij", self._slopes, self._slopes)
        self._low, self._high = model.low, model.high
        self.n_constraints = len(self._offsets) + 2 * model.low.size + 1

    def values(self, step: Array) -> Array:
        """Value of each block after the step."""
        return np.asarray(np.sum((self._offsets + self._slopes @ step) ** 2, axis=1))

    def value(self, point: Array, weight: float) -> float:
        """Cost and barriers; inf outside."""
        rooms = self._rooms(point)
        if rooms.min() <= 0.0:
            return np.inf
        return float(self._cost @ point) - weight * float(np.sum(np.log(rooms)))

    def lowest(self, point: Array, weight: float) -> Array:
        """The minimum for one weight of the barriers."""
        value = self.value(point, weight)
        for _ in range(MAX_NEWTON):
            gradient, hessian = self._derivatives(point, weight)
            newton = _newton(gradient, hessian)
            slope = float(gradient @ newton)
            if -slope < NEWTON_DECREMENT * weight:
                break
            length = 1.0
            for _ in range(HALVINGS):
                trial = point + length * newton
                lower = self.value(trial, weight)
                if lower <= value + ARMIJO * length * slope:
                    break
                length *= 0.5
            else:
                break
            point, value = trial, lower
        return point

    def _rooms(self, point: Array) -> Array:
        step, excess = point[:-1], point[-1]
        blocks = 1.0 + excess - self.values(step)
        return np.concatenate([blocks, step - self._low, self._high - step, [excess]])

    def _derivatives(self, point: Array, weight: float) -> tuple[Array, Array]:
        step, excess = point[:-1], point[-1]
        n = step.size
        after = self._offsets + self._slopes @ step
        tilt = 2.0 * np.einsum("bki,bk->bi", self._slopes, after)
        inverse = 1.0 / (1.0 + excess - np.sum(after**2, axis=1))
        from_low, from_high = 1.0 / (step - self._low), 1.0 / (self._high - step)
        # The excess widens every block.
        rows = np.hstack([tilt * inverse[:, None], -inverse[:, None]])
        gradient = rows.sum(axis=0)
        gradient[:n] += from_high - from_low
        gradient[n] -= 1.0 / excess
        hessian = rows.T @ rows
        hessian[:n, :n] += np.tensordot(inverse, self._curvature, axes=1)
        hessian.flat[:: n + 2] += np.append(from_low**2 + from_high**2, 1.0 / excess**2)
        return self._cost + weight * gradient, weight * hessian


def _newton(gradient: Array, hessian: Array) -> Array:
    """The Newton step of a convex function."""
    scale = 1.0 / np.sqrt(np.diag(hessian))
    scaled = scale[:, None] * hessian * scale
    # Rounding can cost a stiff barrier its last positive eigenvalue.
    scaled.flat[:: len(scaled) + 1] += ROUNDING
    return np.asarray(-scale * np.linalg.solve(scaled, scale * gradient))
