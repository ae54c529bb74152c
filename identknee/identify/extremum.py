"""The largest and the smallest value of a quantity inside a region, by local search."""

from enum import Enum, unique

import clarabel
import numpy as np
from scipy import sparse

from identknee.calibrate.problem import RANK_TOLERANCE
from identknee.calibrate.quantity import Quantity
from identknee.identify.region import Blocks, PairView, RegionConstraints, RegionView
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, OF_QUANTITY, array, declared, entry

# Of the best step, whose value is about 1; and what is taken where rounding forbids that.
GAP, LARGEST_GAP = 1e-10, 1e-7


@declared
class ModelStep:
    """The best step of a model.

    Attributes
    ----------
    step
        The step, shape ``(n,)``.
    excess
        How much the limit of 1 had to be raised for it, about 0 where the model's region is not
        empty.
    multipliers
        By how much the best gain grows with the limit of each block, shape ``(n_blocks,)``.
    """

    step: Array
    excess: float
    multipliers: Array


@declared
class LocalModel:
    """The local model around a point, in the units of its steps.

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


def best_step(model: LocalModel, *, penalty: float) -> ModelStep:
    """The step of largest gain, less `penalty` times the excess, in a model.

    It keeps to ``|offsets[b] + slopes[b] @ step|^2 <= 1 + excess`` for every block, to the model's
    bounds and to ``excess >= 0``: a second-order cone program with an interior whatever the blocks
    are, solved by Clarabel's interior-point method.

    Parameters
    ----------
    model
        What to maximise, and where.
    penalty
        Price of an excess; large enough, and there is none unless the model's region is empty.

    References
    ----------
    P. J. Goulart and Y. Chen, Clarabel: An interior-point solver for conic programs with quadratic
    objectives (2024), doi:10.48550/arXiv.2405.12762.
    """
    n_blocks, k, n = model.blocks.slopes.shape
    n_linear = 2 * n + 1
    matrix = np.zeros((n_linear + n_blocks * (k + 2), n + 1))
    right = np.zeros(len(matrix))
    matrix[:n, :n], right[:n] = -np.eye(n), -model.low
    matrix[n : 2 * n, :n], right[n : 2 * n] = np.eye(n), model.high
    matrix[2 * n, n] = -1.0
    # |u|^2 <= 1 + excess is |(excess, 2 u)| <= 2 + excess, which is what a cone can say.
    rows, ends = matrix[n_linear:].reshape(n_blocks, k + 2, n + 1), right[n_linear:]
    rows[:, :2, n], rows[:, 2:, :n] = -1.0, -2.0 * model.blocks.slopes
    ends = ends.reshape(n_blocks, k + 2)
    ends[:, 0], ends[:, 2:] = 2.0, 2.0 * model.blocks.offsets
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n + 1, n + 1)),
        np.r_[-model.gain, penalty],
        sparse.csc_matrix(matrix),
        right,
        [clarabel.NonnegativeConeT(n_linear), *(clarabel.SecondOrderConeT(k + 2),) * n_blocks],
        _settings(),
    ).solve()
    point = np.array(solution.x)
    forces = np.array(solution.z)[n_linear:].reshape(n_blocks, k + 2)
    return ModelStep(
        step=np.clip(point[:n], model.low, model.high),
        excess=max(float(point[n]), 0.0),
        multipliers=forces[:, 0] + forces[:, 1],
    )


def _settings() -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # The problems are tiny, and other processes have the other cores.
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = GAP
    settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = LARGEST_GAP
    settings.reduced_tol_feas = LARGEST_GAP
    return settings


# A point counts as inside up to this excess over the limit, relative to it.
INSIDE_TOLERANCE = 1e-6
# Gain, in half-widths of the quantity's range in the linear model of the region.
GAIN_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-6
LIMIT_TOLERANCE = 1e-5
FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 2.0, 64.0, 1e-7
ACCEPTED, GOOD, POOR = 0.05, 0.6, 0.25
# The price of leaving the region, in multiples of what it gains: as little above 1 as keeps a
# search from ending outside, because along a curved boundary every step leaves a little.
PRICE, LOWEST_PRICE, HIGHEST_PRICE = 1.2, 1e-2, 1e2
MAX_STEPS = 200
TINY = float(np.finfo(float).tiny)


@unique
class ExtremumEnd(Enum):
    """What limits a quantity; the value is the word written to files."""

    LIMIT = "limit"
    BOUND = "bound"
    INTERIOR = "interior"
    CLIFF = "cliff"
    BUDGET = "budget"

    @property
    def sentence(self) -> str:
        """What happened, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    ExtremumEnd.LIMIT: "Beyond this point the predictions differ by more than the limit.",
    ExtremumEnd.BOUND: "Only the parameter bounds limit it; the data do not.",
    ExtremumEnd.INTERIOR: "A local extremum inside the region, away from its limit and bounds.",
    ExtremumEnd.CLIFF: "The model has no equilibrium beyond; the range may be wider.",
    ExtremumEnd.BUDGET: "The search reached its step limit; the range may be wider.",
}


@declared
class Extreme:
    """Where one search for an extremum ended."""

    theta: Array = array("The end of the search", "parameter", unit=OF_PARAMETER)
    value: float = entry("The quantity there", unit=OF_QUANTITY)
    largest: float = entry("The largest block over the limit, simulated there; at most 1 + 1e-6")
    end: ExtremumEnd = entry("What stopped it")
    path: Array = array("The points inside that it came by", "point", "parameter")


@declared
class _Point:
    theta: Array
    value: float
    gradient: Array
    blocks: Blocks

    @property
    def excess(self) -> float:
        return max(self.blocks.largest - 1.0, 0.0)


def extremise(
    inside: RegionConstraints, quantity: Quantity, start: Array, *, sign: float
) -> Extreme:
    """The largest (`sign` = 1) or smallest (-1) value that a search from `start` finds inside.

    Every step is the best one by a model: the quantity linear, each block the square of its
    residuals' linear model, within the bounds and a trust region. The exact Jacobian makes that a
    fast way along a narrow region, and simulations alone decide what is accepted.

    Parameters
    ----------
    inside
        The region.
    quantity
        What to make large or small.
    start
        A point with a prediction, shape ``(n,)``, within the bounds, in the region or near it.
    sign
        1 or -1.

    References
    ----------
    R. Fletcher, Practical Methods of Optimization, Wiley 1987, section 14.4 (exact penalty and
    trust region).
    """
    search = _Search(inside, quantity, sign)
    here = search.point(np.clip(start, inside.lower, inside.upper))
    if here is None:
        raise ValueError("the search for an extremum must start where there is a prediction")
    best, end = search.climb(here)
    if end not in {ExtremumEnd.CLIFF, ExtremumEnd.BUDGET}:
        end = ExtremumEnd.BOUND if at_bounds(best.theta, inside).any() else ExtremumEnd.INTERIOR
        if best.blocks.largest >= 1.0 - LIMIT_TOLERANCE:
            end = ExtremumEnd.LIMIT
    return Extreme(
        theta=best.theta,
        value=best.value,
        largest=best.blocks.largest,
        end=end,
        path=np.array(search.path).reshape(-1, best.theta.size),
    )


def at_bounds(theta: Array, inside: RegionConstraints) -> Array:
    """Which parameters lie on one of their bounds, shape ``(n,)``."""
    tolerance = BOUND_TOLERANCE * inside.steps
    return np.asarray((theta <= inside.lower + tolerance) | (theta >= inside.upper - tolerance))


class PairDistance:
    """The distance of two points of one region in typical steps, as a quantity.

    Parameters
    ----------
    steps
        Typical steps of the parameters, shape ``(n,)``.
    """

    name = "distance"
    unit = "typical steps"

    def __init__(self, steps: Array) -> None:
        self._steps = steps

    def evaluate(self, theta: Array) -> tuple[float, Array]:
        """The distance, and its gradient by both points, shape ``(2 n,)``."""
        n = self._steps.size
        apart = (theta[:n] - theta[n:]) / self._steps
        distance = float(np.linalg.norm(apart))
        slope = apart / (max(distance, np.finfo(float).tiny) * self._steps)
        return distance, np.r_[slope, -slope]


def farthest_pair(view: RegionView, first: Array, second: Array) -> Extreme:
    """Two points of the region as far apart as a search from two others finds them.

    Theta of the answer holds one after the other, shape ``(2 n,)``.

    Parameters
    ----------
    view
        The region.
    first, second
        Points with a prediction, shape ``(n,)``, not the same.
    """
    start = np.concatenate([first, second])
    return extremise(PairView(view), PairDistance(view.steps), start, sign=1.0)


class _Search:
    """A trust-region search that maximises sign * quantity less a penalty outside the region."""

    def __init__(self, inside: RegionConstraints, quantity: Quantity, sign: float) -> None:
        self._inside = inside
        self._quantity = quantity
        self._sign = sign
        self._price = LOWEST_PRICE
        self._unit = 1.0
        self.path: list[Array] = []

    def point(self, theta: Array) -> _Point | None:
        """The point, None where there is no prediction."""
        blocks = self._inside(theta)
        if not np.isfinite(blocks.largest):
            return None
        value, gradient = self._quantity.evaluate(theta)
        if not (np.isfinite(value) and np.all(np.isfinite(gradient))):
            return None
        return _Point(theta=theta, value=value, gradient=gradient, blocks=blocks)

    def climb(self, here: _Point) -> tuple[_Point, ExtremumEnd]:
        """The best point inside that the steps lead to, and what ended them."""
        best, radius, met_cliff = here, FIRST_RADIUS, False
        self._unit = self._range(here)
        for _ in range(MAX_STEPS):
            if self._unit == 0.0:
                return best, ExtremumEnd.INTERIOR
            step, gain = self._model_step(here, radius)
            if gain < GAIN_TOLERANCE * min(1.0, radius):
                return best, ExtremumEnd.LIMIT
            there = self.point(self._moved(here.theta, step.step))
            ratio = -np.inf if there is None else (self._merit(there) - self._merit(here)) / gain
            radius = _next_radius(radius, ratio, float(np.max(np.abs(step.step))))
            if there is not None and ratio > ACCEPTED:
                here, met_cliff = there, False
                if here.excess <= INSIDE_TOLERANCE:
                    self.path.append(here.theta)
                best = self._better(best, here)
                continue
            met_cliff |= there is None
            if radius < SMALLEST_RADIUS:
                return best, ExtremumEnd.CLIFF if met_cliff else ExtremumEnd.LIMIT
        return best, ExtremumEnd.BUDGET

    def _model_step(self, here: _Point, radius: float) -> tuple[ModelStep, float]:
        """The model's best step in typical steps, and its predicted gain."""
        inside, steps = self._inside, self._inside.steps
        model = LocalModel(
            gain=self._sign * here.gradient * steps / self._unit,
            blocks=Blocks(offsets=here.blocks.offsets, slopes=here.blocks.slopes * steps),
            low=np.maximum((inside.lower - here.theta) / steps, -radius),
            high=np.minimum((inside.upper - here.theta) / steps, radius),
        )
        best = best_step(model, penalty=HIGHEST_PRICE)
        self._price = max(PRICE * float(best.multipliers.sum()), LOWEST_PRICE)
        return best, float(model.gain @ best.step) + self._price * (here.excess - best.excess)

    def _moved(self, theta: Array, step: Array) -> Array:
        inside = self._inside
        return np.clip(theta + inside.steps * step, inside.lower, inside.upper)

    def _merit(self, point: _Point) -> float:
        return self._sign * point.value / self._unit - self._price * point.excess

    def _better(self, best: _Point, here: _Point) -> _Point:
        """A point inside before one outside, then the larger value."""
        if here.excess > INSIDE_TOLERANCE:
            return best if best.excess <= here.excess else here
        is_first = best.excess > INSIDE_TOLERANCE
        return here if is_first or self._sign * (here.value - best.value) >= 0 else best

    def _range(self, here: _Point) -> float:
        """Half the range of the quantity in the linear model of region and bounds at a point."""
        steps = self._inside.steps
        gain = here.gradient * steps
        slopes = here.blocks.slopes * steps
        n_blocks = len(slopes)
        _, size, right = np.linalg.svd(slopes.reshape(-1, steps.size), full_matrices=False)
        known = np.maximum(size, RANK_TOLERANCE * size[0] + TINY)
        reach = np.sqrt(n_blocks) * np.abs(right @ gain) / known
        box = np.abs(gain) @ ((self._inside.upper - self._inside.lower) / (2.0 * steps))
        return min(float(np.linalg.norm(reach)), float(box))


def _next_radius(radius: float, ratio: float, length: float) -> float:
    if ratio < POOR:
        return 0.25 * min(radius, length)
    if ratio > GOOD and length > 0.9 * radius:
        return min(2.0 * radius, LARGEST_RADIUS)
    return radius
