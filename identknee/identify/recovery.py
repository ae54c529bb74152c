"""How close an initial guess must be: the probability of recovery against its distance."""

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from scipy.special import log_expit, logit

from identknee.identify.shares import Share, share
from identknee.identify.starts_design import distance
from identknee.identify.sweep import Sweep
from identknee.runs.arrays import Array, BoolArray, frozen

MAX_SHELLS = 20
N_BINS = 10
# Half the 95 % quantile of chi squared with one degree of freedom.
DROP = 1.9207
# A thousand logits over the range of distances is a step for any sample.
STEEPEST = 1e3
N_GRID = 100
# Of the log likelihood: a difference that is rounding of the refitted slope.
SAME = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recovery:
    """Shares of starts that recovered a target, by their distance from it.

    Attributes
    ----------
    distances
        Mean distance of the starts in each group, ascending, shape ``(k,)``.
    shares
        Of those, the ones that recovered.
    """

    distances: Array
    shares: tuple[Share, ...]

    def __post_init__(self) -> None:
        values = frozen(self.distances, len(self.shares), name="distances")
        object.__setattr__(self, "distances", values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Radius:
    """The distance within which a start recovers with a stated probability.

    Attributes
    ----------
    probability
        The one stated.
    value
        The distance where a logistic curve crosses it; 0 where even starts at the target recover
        less often, infinite where the curve does not fall to it.
    lower, upper
        Limits at 95 % confidence by the likelihood ratio; 0 and infinity where they are open.
    """

    probability: float
    value: float
    lower: float
    upper: float


def is_recovered(
    sweep: Sweep, target: Array, *, within: float, polished: bool = False
) -> BoolArray:
    """Which searches ended near the target, shape ``(N,)``.

    Parameters
    ----------
    sweep
        The searches.
    target
        Truth or best fit, shape ``(p,)``.
    within
        How far the end may be, as `identknee.identify.starts_design.distance` counts: kN and %.
    polished
        Whether the polished end is meant, and not that of the optimizer.
    """
    ends = sweep.polished if polished else sweep.ends
    objectives = sweep.polished_objectives if polished else sweep.objectives
    near = distance(ends, target, sweep.parameters) <= within
    return np.asarray(near & np.isfinite(objectives))


def recovery(distances: Array, recovered: BoolArray) -> Recovery:
    """The share recovered at each distance of the starts, or in ten groups of equal size.

    Parameters
    ----------
    distances
        Of the starts from the target, shape ``(N,)``. Twenty different ones at most are shells.
    recovered
        From `is_recovered`, shape ``(N,)``.
    """
    shells, place = np.unique(np.round(distances, 9), return_inverse=True)
    if len(shells) > MAX_SHELLS:
        order = np.argsort(distances, kind="stable")
        place = np.empty(len(distances), dtype=np.int64)
        place[order] = np.arange(len(distances)) * N_BINS // len(distances)
    groups = range(int(place.max()) + 1)
    return Recovery(
        distances=np.array([distances[place == k].mean() for k in groups]),
        shares=tuple(
            share(int(recovered[place == k].sum()), int(np.sum(place == k))) for k in groups
        ),
    )


def radius(distances: Array, recovered: BoolArray, *, probability: float = 0.95) -> Radius:
    """The distance within which a start recovers with `probability`, by a falling logistic curve.

    Raises
    ------
    ValueError
        If the probability is not between 0 and 1, or there is no start.

    Notes
    -----
    The curve is ``logit P(d) = logit(probability) - slope * (d - radius)`` with a slope of 0 or
    more. The limits are where the likelihood, the slope refitted, falls to exp(-1.92) of the
    highest one.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"the probability must be between 0 and 1, got {probability:g}")
    if len(distances) == 0:
        raise ValueError("there is no start to learn a radius from")
    curve = _Curve(distances, recovered, probability)
    # Beyond the starts on both sides, to see whether the likelihood still falls there.
    low, high = 0.0, 2.0 * max(curve.farthest, 1e-9)
    grid = np.linspace(low, high, N_GRID + 1)
    heights = np.array([curve.height(x) for x in grid])
    best = int(np.argmax(heights))
    near = grid[max(best - 1, 0)], grid[min(best + 1, N_GRID)]
    finest = scipy.optimize.minimize_scalar(
        lambda x: -curve.height(x), bounds=near, method="bounded"
    )
    value, top = (
        (float(finest.x), -float(finest.fun))
        if -finest.fun > heights[best]
        else (float(grid[best]), float(heights[best]))
    )
    inside = np.flatnonzero(heights >= top - DROP)
    limit = top - DROP
    return Radius(
        probability=probability,
        value=np.inf if heights[-1] >= top - SAME else value,
        lower=_crossing(curve, grid, int(inside[0]) if inside.size else best, -1, limit),
        upper=_crossing(curve, grid, int(inside[-1]) if inside.size else best, 1, limit),
    )


class _Curve:
    """Likelihood of a radius, the slope of the curve refitted."""

    def __init__(self, distances: Array, recovered: BoolArray, probability: float) -> None:
        # Starts on one shell count together, so that a million cost what a shell costs.
        self._distances, place = np.unique(np.round(distances, 6), return_inverse=True)
        self._n = np.bincount(place).astype(np.float64)
        self._k = np.bincount(place, weights=recovered)
        self._logit = float(logit(probability))
        self.farthest = float(self._distances[-1])

    def height(self, radius: float) -> float:
        """Highest log likelihood over all slopes."""
        beyond = self._distances - radius
        steepest = STEEPEST / max(self.farthest, 1e-9)

        def loss(root: float) -> float:
            logits = self._logit - root**2 * beyond
            hits = self._k @ log_expit(logits)
            return -float(hits + (self._n - self._k) @ log_expit(-logits))

        found = scipy.optimize.minimize_scalar(
            loss, bounds=(0.0, np.sqrt(steepest)), method="bounded"
        )
        return -min(float(found.fun), loss(0.0), loss(float(np.sqrt(steepest))))


def _crossing(curve: _Curve, grid: Array, inside: int, side: int, limit: float) -> float:
    """Where the likelihood crosses `limit` next to the grid point `inside`; open at the ends."""
    outside = inside + side
    if outside < 0:
        return 0.0
    if outside >= len(grid):
        return np.inf
    pair = sorted((grid[inside], grid[outside]))
    if curve.height(grid[inside]) < limit:
        return float(grid[inside])
    return float(scipy.optimize.brentq(lambda x: curve.height(x) - limit, *pair, xtol=1e-6))
