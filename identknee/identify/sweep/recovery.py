"""How close an initial guess must be: the probability of recovery against its distance."""

import numpy as np
import scipy.optimize

from identknee.identify.shares import Share, share
from identknee.identify.sweep.starts_design import DISTANCE, distance
from identknee.identify.sweep.sweep import Searches
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, derived, entry

MAX_SHELLS = 20
N_BINS = 10
# Nine of ten: fifty of fifty starts are enough to be sure of it.
OFTEN = 0.9


@declared
class Radius:
    """The distance within which a start recovers with a stated probability."""

    probability: float = entry("Probability stated", unit="1")
    value: float = entry(
        "Distance at which a falling curve through the shares crosses it; 0 where even the nearest "
        "starts recover less often, null where the farthest ones still recover as often",
        unit=DISTANCE,
    )
    lower: float = entry("The same of the lower limits of the shares, 95 % each", unit=DISTANCE)
    upper: float = entry("The same of their upper limits", unit=DISTANCE)


@declared
class Recovery:
    """Shares of starts that recovered a target, by their distance from it."""

    distances: Array = array(
        "Mean distance from the target of the starts in each group, ascending",
        "distance",
        unit=DISTANCE,
        is_in_json=True,
    )
    shares: tuple[Share, ...] = entry(
        "Share of the starts in each group that recovered it", rows="distance"
    )

    @property
    @derived("Distance within which nine of ten starts recover it")
    def radius(self) -> Radius:
        """The radius for a probability of 0.9."""
        return radius(self)


def is_recovered(
    searches: Searches, target: Array, *, within: float, polished: bool = False
) -> BoolArray:
    """Which searches ended near the target, shape ``(N,)``.

    Parameters
    ----------
    searches
        The searches.
    target
        Truth or best fit, shape ``(p,)``.
    within
        How far the end may be, as `identknee.identify.sweep.starts_design.distance` counts: kN
        and %.
    polished
        Whether the polished end is meant, and not that of the optimizer.
    """
    ends = searches.polished if polished else searches.ends
    objectives = searches.polished_objectives if polished else searches.objectives
    near = distance(ends, target, searches.parameters) <= within
    return np.asarray(near & np.isfinite(objectives))


def recovery(distances: Array, recovered: BoolArray) -> Recovery:
    """The share recovered at each distance of the starts, or in ten groups of equal size.

    Parameters
    ----------
    distances
        Distances of the starts from the target, shape ``(N,)``. If at most twenty of them differ,
        they are taken as shells.
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


def radius(found: Recovery, *, probability: float = OFTEN) -> Radius:
    """The distance within which a start recovers with `probability`, or as good as.

    The curve is the falling one that fits the shares best (isotonic regression, each share weighted
    by its starts), straight between the distances.

    Raises
    ------
    ValueError
        If the probability is not between 0 and 1.

    References
    ----------
    .. [1] Barlow, Bartholomew, Bremner, Brunk (1972), Statistical inference under order
           restrictions, chapter 1. Wiley.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"the probability must be between 0 and 1, got {probability:g}")
    shares, lower, upper = (
        np.array([getattr(x, name) for x in found.shares]) for name in ("value", "lower", "upper")
    )
    weights = [x.n for x in found.shares]
    fitted = scipy.optimize.isotonic_regression(shares, weights=weights, increasing=False).x
    # The truth falls, so that a limit holds for all that is farther, or nearer.
    curves = (fitted, np.minimum.accumulate(lower), np.maximum.accumulate(upper[::-1])[::-1])
    value, low, high = (_crossing(found.distances, curve, probability) for curve in curves)
    return Radius(probability=probability, value=value, lower=low, upper=high)


def _crossing(distances: Array, curve: Array, level: float) -> float:
    """Where a falling curve comes below `level`."""
    below = np.flatnonzero(curve < level)
    if below.size == 0:
        return np.inf
    first = int(below[0])
    if first == 0:
        return 0.0
    part = (curve[first - 1] - level) / (curve[first - 1] - curve[first])
    return float(distances[first - 1] + part * (distances[first] - distances[first - 1]))
