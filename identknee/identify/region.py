"""The region of parameter sets with predictions equivalent to a given one's, and extrema in it."""

from collections.abc import Mapping, Sequence
from enum import unique
from typing import Protocol

import clarabel
import numpy as np
import scipy
from scipy import sparse

from identknee.calibrate.problem import RANK_TOLERANCE, Evaluator, Problem, Quantity, typical_steps
from identknee.runs.declare import OF_PARAMETER, OF_QUANTITY, Array, array, declared, entry, frozen
from identknee.runs.record import WithSentence

ALL = "all"
LEVEL = 0.05


@declared
class Region:
    """Parameter sets whose predictions differ from those at `center` by no more than a limit.

    The difference is measured in blocks. The value of a block is the weighted sum of squares
    ``sum_i (weight_i (r_i(theta) - r_i(center)))^2`` of the residuals `r`; since both residuals
    are taken against the same data, that is the difference of two predictions. A parameter set
    belongs to the region where it is within the bounds, has a prediction, and no block's value
    exceeds the limit.

    One block of weight 1 on residuals in units of their noise is the squared noise-weighted
    distance D^2 of two predictions.
    """

    problem: Problem = entry("The problem")
    center: Array = array("Theta of the fit", "parameter", unit=OF_PARAMETER)
    blocks: Mapping[str, Array] = entry("Weights of the residuals by name of the block")
    limit: float = entry("The largest value of a block", default=1.0)

    def __post_init__(self) -> None:
        if not 0 < self.limit < np.inf:
            raise ValueError(f"the limit must be greater than 0 and finite, got {self.limit:g}")
        if not self.blocks:
            raise ValueError("there is no block of residuals to compare predictions by; give one")


def noise_region(problem: Problem, center: Array, *, limit: float = 1.0) -> Region:
    """The region in which D^2, the squared noise-weighted distance of predictions, is in the limit.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    center
        Theta of the fit, shape ``(n,)``.
    limit
        Largest D^2. At 1 the best one-sided 5 % test of one prediction against the other has a
        power of 26 % (see `power_of_best_test`).

    Raises
    ------
    ValueError
        If the limit is not greater than 0.
    """
    m = np.asarray(problem.residuals(np.array(center, dtype=np.float64))).size
    return Region(problem=problem, center=center, blocks={ALL: np.ones(m)}, limit=limit)


def power_of_best_test(squared_distance: float) -> float:
    """Power of the best one-sided 5 % test between two predictions by one measurement.

    Both predictions are known and the noise is normal, so that the likelihood-ratio test is the
    most powerful one there is (Neyman and Pearson); it sees a shift of D standard deviations.

    Examples
    --------
    >>> round(power_of_best_test(1.0), 2)
    0.26
    """
    return float(scipy.stats.norm.sf(scipy.stats.norm.isf(LEVEL) - np.sqrt(squared_distance)))


@declared
class Blocks:
    """The blocks of a region at one theta, each with its Gauss-Newton model, limits taken as 1.

    After a step `d` the model gives block b the value ``|offsets[b] + slopes[b] @ d|^2``.
    """

    offsets: Array = entry(
        "Weighted differences of the predictions, shape ``(n_blocks, k)``; infinite where there "
        "is no prediction"
    )
    slopes: Array = entry("Their derivatives, shape ``(n_blocks, k, n)``")

    @property
    def values(self) -> Array:
        """Value of each block over the limit, shape ``(n_blocks,)``; inf without a prediction."""
        return np.asarray(np.einsum("bk,bk->b", self.offsets, self.offsets))

    @property
    def largest(self) -> float:
        """The largest of these: the point is inside up to 1."""
        return float(self.values.max())


class RegionConstraints(Protocol):
    """Constraints of a search for an extremum."""

    @property
    def lower(self) -> Array:
        """Lower bounds, shape ``(n,)``."""

    @property
    def upper(self) -> Array:
        """Upper bounds, shape ``(n,)``."""

    @property
    def steps(self) -> Array:
        """Typical steps, shape ``(n,)``."""

    def __call__(self, theta: Array) -> Blocks:
        """Blocks at `theta`, shape ``(n,)``."""


class RegionView:
    """A region as a search sees it, its simulations counted.

    Raises
    ------
    ValueError
        If the model has no prediction at the fit, or weights and residuals differ in number.
    """

    def __init__(self, region: Region) -> None:
        self.region = region
        self.evaluator = Evaluator(region.problem)
        self.lower = region.problem.parameters.lower
        self.upper = region.problem.parameters.upper
        self.steps = typical_steps(region.problem.parameters)
        center = self.evaluator(region.center)
        if not center.is_finite:
            raise ValueError(
                "the model has no prediction at the parameter set to compare with; "
                "give a fitted one"
            )
        self._at_center = center.residuals
        m = center.residuals.size
        self._rows = []
        for name, weights in region.blocks.items():
            checked = frozen(weights, m, name=f"the weights of {name}") / np.sqrt(region.limit)
            rows = np.flatnonzero(checked)
            self._rows.append((rows, checked[rows]))

    @property
    def n_simulations(self) -> int:
        """Simulations made so far."""
        return self.evaluator.n_simulations

    def __call__(self, theta: Array) -> Blocks:
        """Blocks at `theta`, shape ``(n,)``: one simulation."""
        evaluation = self.evaluator(theta)
        n = evaluation.theta.size
        shape = (len(self._rows), n + 1)
        if not evaluation.is_finite:
            return Blocks(offsets=np.full(shape, np.inf), slopes=np.full((*shape, n), np.nan))
        difference = evaluation.residuals - self._at_center
        offsets, slopes = np.zeros(shape), np.zeros((*shape, n))
        for b, (rows, weights) in enumerate(self._rows):
            rows_of_block = weights[:, None] * np.c_[evaluation.jacobian[rows], difference[rows]]
            # The triangle has the same lengths as the many rows it stands for.
            triangle = np.asarray(np.linalg.qr(rows_of_block, mode="r"))
            slopes[b, : len(triangle)] = triangle[:, :n]
            offsets[b, : len(triangle)] = triangle[:, n]
        return Blocks(offsets=offsets, slopes=slopes)


class PairView:
    """Two points of a region as one point of twice as many parameters."""

    def __init__(self, view: RegionView) -> None:
        self._view = view
        self.lower = np.tile(view.lower, 2)
        self.upper = np.tile(view.upper, 2)
        self.steps = np.tile(view.steps, 2)

    def __call__(self, theta: Array) -> Blocks:
        """Blocks of both points, shape ``(2 n,)``: two simulations."""
        n = theta.size // 2
        first, second = self._view(theta[:n]), self._view(theta[n:])
        nothing = np.zeros_like(first.slopes)
        return Blocks(
            offsets=np.concatenate([first.offsets, second.offsets]),
            slopes=np.concatenate(
                [
                    np.concatenate([first.slopes, nothing], axis=2),
                    np.concatenate([nothing, second.slopes], axis=2),
                ]
            ),
        )


# Of the best step, whose value is about 1; and what is taken where rounding forbids that.
GAP, LARGEST_GAP = 1e-10, 1e-7


@declared
class ModelStep:
    """The best step of a model."""

    step: Array = entry("The step, shape ``(n,)``")
    excess: float = entry(
        "How much the limit of 1 had to be raised for it, about 0 where the model's region is "
        "not empty"
    )
    multipliers: Array = entry(
        "By how much the best gain grows with the limit of each block, shape ``(n_blocks,)``"
    )


@declared
class LocalModel:
    """The local model around a point, in the units of its steps."""

    gain: Array = entry(
        "Derivatives of the quantity, shape ``(n,)``, of such a size that the best step's gain "
        "is about 1"
    )
    blocks: Blocks = entry("The region's blocks, finite")
    low: Array = entry("Bounds of the step, shape ``(n,)``, with ``low < high`` and 0 between them")
    high: Array = entry(
        "Bounds of the step, shape ``(n,)``, with ``low < high`` and 0 between them"
    )


def best_step(model: LocalModel, *, penalty: float) -> ModelStep:
    """The step of largest gain, less `penalty` times the excess, in a model.

    It keeps to ``|offsets[b] + slopes[b] @ step|^2 <= 1 + excess`` for every block, to the model's
    bounds and to ``excess >= 0``: a second-order cone program with an interior whatever the blocks
    are, solved by Clarabel's interior-point method.

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
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # The problems are tiny, and other processes have the other cores.
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = GAP
    settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = LARGEST_GAP
    settings.reduced_tol_feas = LARGEST_GAP
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((n + 1, n + 1)),
        np.r_[-model.gain, penalty],
        sparse.csc_matrix(matrix),
        right,
        [clarabel.NonnegativeConeT(n_linear), *(clarabel.SecondOrderConeT(k + 2),) * n_blocks],
        settings,
    ).solve()
    point = np.array(solution.x)
    forces = np.array(solution.z)[n_linear:].reshape(n_blocks, k + 2)
    return ModelStep(
        step=np.clip(point[:n], model.low, model.high),
        excess=max(float(point[n]), 0.0),
        multipliers=forces[:, 0] + forces[:, 1],
    )


# A point counts as inside up to this excess over the limit, relative to it.
INSIDE_TOLERANCE = 1e-6
# Gain, in half-widths of the quantity's range in the linear model of the region.
GAIN_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-6
LIMIT_TOLERANCE = 1e-3
FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 2.0, 64.0, 1e-7
ACCEPTED, GOOD, POOR = 0.05, 0.6, 0.25
# The price of leaving the region, in multiples of what it gains: as little above 1 as keeps a
# search from ending outside, because along a curved boundary every step leaves a little.
PRICE, LOWEST_PRICE, HIGHEST_PRICE = 1.2, 1e-2, 1e2
MAX_STEPS = 200
# A search that moves by less than this, in half-widths of the quantity's range, in so many steps
# creeps along kinks: in all its steps it would gain a few thousandths of the range.
CREEP_STEPS, CREEP_GAIN = 15, 5e-4
# Shares of the way back inside that are tried, in multiples of the excess.
PULLED_BACK = 4.0 ** np.arange(1, 8)
TINY = float(np.finfo(float).tiny)


@unique
class ExtremumEnd(WithSentence):
    """What limits a quantity; the value is the word written to files."""

    LIMIT = ("limit", "Beyond this point the predictions differ by more than the limit.")
    BOUND = ("bound", "Only the parameter bounds limit it; the data do not.")
    INTERIOR = ("interior", "A local extremum inside the region, away from its limit and bounds.")
    CLIFF = ("cliff", "The model has no equilibrium beyond; the range may be wider.")
    CREASE = ("crease", "The search crept along creases; the range may be a little wider.")
    BUDGET = ("budget", "The search reached its step limit; the range may be wider.")


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
        if best.blocks.largest >= 1.0 - LIMIT_TOLERANCE:
            end = ExtremumEnd.LIMIT
        elif at_bounds(best.theta, inside).any():
            end = ExtremumEnd.BOUND
        elif end is not ExtremumEnd.CREASE:
            end = ExtremumEnd.INTERIOR
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
        # Half the range of the quantity in the linear model of region and bounds at a point.
        inside, steps = self._inside, self._inside.steps
        slope = here.gradient * steps
        slopes = here.blocks.slopes * steps
        _, size, right = np.linalg.svd(slopes.reshape(-1, steps.size), full_matrices=False)
        known = np.maximum(size, RANK_TOLERANCE * size[0] + TINY)
        reach = np.sqrt(len(slopes)) * np.abs(right @ slope) / known
        box = np.abs(slope) @ ((inside.upper - inside.lower) / (2.0 * steps))
        self._unit = min(float(np.linalg.norm(reach)), float(box))
        passed: list[_Point] = []
        last_cliff = -CREEP_STEPS
        for k in range(MAX_STEPS):
            if self._unit == 0.0:
                return best, ExtremumEnd.INTERIOR
            passed.append(here)
            if self._creeps(passed):
                best = self._pulled_back(here, best)
                is_inside = best.blocks.largest < 1.0 - LIMIT_TOLERANCE
                is_cliff = is_inside and k - last_cliff < CREEP_STEPS
                return best, ExtremumEnd.CLIFF if is_cliff else ExtremumEnd.CREASE
            # The model's best step in typical steps, and its predicted gain.
            model = LocalModel(
                gain=self._sign * here.gradient * steps / self._unit,
                blocks=Blocks(offsets=here.blocks.offsets, slopes=here.blocks.slopes * steps),
                low=np.maximum((inside.lower - here.theta) / steps, -radius),
                high=np.minimum((inside.upper - here.theta) / steps, radius),
            )
            step = best_step(model, penalty=HIGHEST_PRICE)
            self._price = max(PRICE * float(step.multipliers.sum()), LOWEST_PRICE)
            gain = float(model.gain @ step.step) + self._price * (here.excess - step.excess)
            if gain < GAIN_TOLERANCE * min(1.0, radius):
                return best, ExtremumEnd.LIMIT
            moved = np.clip(here.theta + steps * step.step, inside.lower, inside.upper)
            there = self.point(moved)
            ratio = -np.inf if there is None else (self._merit(there) - self._merit(here)) / gain
            length = float(np.max(np.abs(step.step)))
            if ratio < POOR:
                radius = 0.25 * min(radius, length)
            elif ratio > GOOD and length > 0.9 * radius:
                radius = min(2.0 * radius, LARGEST_RADIUS)
            if there is not None and ratio > ACCEPTED:
                here, met_cliff = there, False
                if here.excess <= INSIDE_TOLERANCE:
                    self.path.append(here.theta)
                # A point inside before one outside, then the larger value.
                if here.excess > INSIDE_TOLERANCE:
                    is_better = not best.excess <= here.excess
                else:
                    is_first = best.excess > INSIDE_TOLERANCE
                    is_better = is_first or self._sign * (here.value - best.value) >= 0
                best = here if is_better else best
                continue
            if there is None:
                met_cliff, last_cliff = True, k
            if radius < SMALLEST_RADIUS:
                return best, ExtremumEnd.CLIFF if met_cliff else ExtremumEnd.LIMIT
        return self._pulled_back(here, best), ExtremumEnd.BUDGET

    def _creeps(self, passed: Sequence[_Point]) -> bool:
        """Whether the last steps led next to nowhere."""
        if len(passed) <= CREEP_STEPS:
            return False
        values = np.array(
            [[x.value / self._unit, self._price * x.excess] for x in passed[-1 - CREEP_STEPS :]]
        )
        return bool(np.all(np.ptp(values, axis=0) < CREEP_GAIN))

    def _pulled_back(self, here: _Point, best: _Point) -> _Point:
        """The better of `best` and a point inside just beside `here`, which may lie outside."""
        if here.excess <= INSIDE_TOLERANCE or best.excess > INSIDE_TOLERANCE:
            return best
        for share in here.excess * PULLED_BACK:
            there = self.point(here.theta + min(share, 1.0) * (best.theta - here.theta))
            if there is not None and there.excess <= INSIDE_TOLERANCE:
                self.path.append(there.theta)
                return there if self._sign * (there.value - best.value) > 0 else best
        return best

    def _merit(self, point: _Point) -> float:
        return self._sign * point.value / self._unit - self._price * point.excess
