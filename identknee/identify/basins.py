"""Basins of attraction: polished ends of searches that share a minimum."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.evaluation import sum_of_squares
from identknee.calibrate.problem import Problem, typical_steps
from identknee.identify.binomial_interval import Proportion, share
from identknee.identify.sweep import DISTANCE, SweepSearches, distance
from identknee.runs.arrays import Array, BoolArray, IntArray, frozen
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry

# In typical steps (3 kN, 2 %): ends closer than this in every parameter are one minimum.
TOLERANCE = 0.01
# Points between two minima where a barrier is looked for, and how many minima next to one are
# looked at.
N_BETWEEN = 7
N_NEIGHBOURS = 3
# Share of the deviance, and the deviance itself, below which a barrier is rounding.
BARRIER_SHARE, BARRIER_FLOOR = 1e-6, 2e-9
NONE = -1
# Minima in the summary; all are among the arrays.
MOST_LISTED = 20


@declared
class Basin:
    """A minimum and the starts that lead to it."""

    theta: Array = array("The minimum", "parameter", unit=OF_PARAMETER)
    objective: float = entry("Half the sum of squares there", unit="1")
    share: Proportion = entry(
        "Share of all starts, failed ones included, whose polished end it is: the volume of the "
        "basin as a part of the volume that the starts fill evenly"
    )


@declared
class Basins:
    """The minima at the polished ends of searches, the lowest first."""

    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    basins: tuple[Basin, ...] = entry(
        "The minima, the lowest first", rows="basin", group="basins", is_in_json=False
    )
    labels: IntArray = array(
        "Place among the basins of each start; -1 where its polishing ended at no minimum",
        "start",
        dtype=int,
        key="basin",
    )

    @property
    @derived("Minima found", unit="1")
    def n_basins(self) -> int:
        """Number of basins."""
        return len(self.basins)

    @property
    @derived("The first twenty minima, with their starts and parameters", key="basins")
    def listed(self) -> list[Mapping[str, Any]]:
        """The first twenty minima in JSON types."""
        return [
            {
                "objective": x.objective,
                "n_starts": x.share.count,
                "share": x.share.value,
                "share_lower": x.share.lower,
                "share_upper": x.share.upper,
                "parameters": dict(zip(self.parameter_names, x.theta.tolist(), strict=True)),
            }
            for x in self.basins[:MOST_LISTED]
        ]

    @override
    def __str__(self) -> str:
        """One line a basin."""
        lines = [
            f"basin {i}: objective {x.objective:.6g}, {x.share}" for i, x in enumerate(self.basins)
        ]
        return "\n".join(lines or ["no basin was found"])


def find_basins(problem: Problem, searches: SweepSearches) -> Basins:
    """The basins among the polished ends of searches.

    Ends that polishing calls minima are gathered from the lowest up: those within 0.01 typical
    steps (0.03 kN, 0.02 %) of one in every parameter are that minimum. Two minima with no barrier
    on the straight line between them are one too: where a direction changes nothing, the minimum
    is not a point.

    Parameters
    ----------
    problem
        That of the searches, to look for barriers; each pair of minima costs seven simulations, the
        starts cost none.
    searches
        The ends.
    """
    scales = typical_steps(searches.parameters)
    labels = np.full(searches.n, NONE, dtype=np.int64)
    leaders: list[int] = []
    left = np.flatnonzero(searches.is_polished)
    left = left[np.argsort(searches.polished_objectives[left], kind="stable")]
    while left.size:
        leader = int(left[0])
        away = np.abs(searches.polished[left] - searches.polished[leader]) / scales
        near = away.max(axis=1) <= TOLERANCE
        joined = _joined(problem, searches, leader, leaders)
        if joined is None:
            joined = len(leaders)
            leaders.append(leader)
        labels[left[near]] = joined
        left = left[~near]
    counts = np.bincount(labels[labels != NONE], minlength=len(leaders))
    return Basins(
        parameter_names=searches.parameters.names,
        basins=tuple(
            Basin(
                theta=searches.polished[leader],
                objective=float(searches.polished_objectives[leader]),
                share=share(int(count), searches.n),
            )
            for leader, count in zip(leaders, counts, strict=True)
        ),
        labels=labels,
    )


def has_barrier(problem: Problem, first: Array, second: Array) -> bool:
    """Whether the deviance rises, or is lost, on the straight line between two points."""
    ends = [sum_of_squares(problem.residuals(x)) for x in (first, second)]
    highest = max(ends) * (1.0 + BARRIER_SHARE) + BARRIER_FLOOR
    for along in np.linspace(0.0, 1.0, N_BETWEEN + 2)[1:-1]:
        between = (1.0 - along) * first + along * second
        if not sum_of_squares(problem.residuals(between)) <= highest:
            return True
    return False


def _joined(problem: Problem, searches: SweepSearches, end: int, leaders: list[int]) -> int | None:
    """Index of the basin that `end` belongs to; None if it is a new one."""
    scales = typical_steps(searches.parameters)
    away = np.max(np.abs(searches.polished[leaders] - searches.polished[end]) / scales, axis=1)
    for place in np.argsort(away, kind="stable")[:N_NEIGHBOURS]:
        if not has_barrier(problem, searches.polished[leaders[place]], searches.polished[end]):
            return int(place)
    return None


@declared
class UnseenMass:
    """Good-Turing estimate of the mass of unseen basins, among starts that end in any."""

    n: int = entry("Starts that ended in a basin", unit="1", key="n_starts")
    n_basins: int = entry("Basins seen", unit="1")
    n_once: int = entry("Basins seen by one start only", unit="1", key="n_basins_seen_once")
    estimate: float = entry(
        "Good and Turing's estimate of the share of starts that would show a new basin: basins "
        "seen once over starts; null without a start",
        unit="1",
    )
    upper: float = entry("Upper limit of that share at 95 % confidence", unit="1")


def unseen_mass(labels: IntArray) -> UnseenMass:
    """The unseen mass from the basin of each start, in the order in which the starts were drawn.

    The limit is that of the mass not seen by the first half of the starts: given those, each start
    of the second half shows a new basin with that probability, so that the Clopper-Pearson limit of
    the share that did is exact for independent starts, whatever the basins. All starts together
    leave no more unseen than the first half does. Starts of a Sobol sequence are spread more evenly
    than independent ones.

    Parameters
    ----------
    labels
        From `identknee.identify.basins.find_basins`, shape ``(N,)``; -1 is left out.

    References
    ----------
    .. [1] Good (1953), Biometrika 40(3-4), 237-264. https://doi.org/10.1093/biomet/40.3-4.237

    Examples
    --------
    >>> unseen_mass(np.array([0, 0, 1, 0, 0, 0, 0, 0])).estimate
    0.125
    """
    seen = labels[labels != NONE]
    counts = np.unique(seen, return_counts=True)[1]
    half = len(seen) // 2
    is_new = ~np.isin(seen[half:], seen[:half])
    # One-sided: the upper limit at 97.5 % of the two-sided one, so on the safe side.
    limit = share(int(is_new.sum()), len(is_new)).upper if half else 1.0
    once = int(np.sum(counts == 1))
    return UnseenMass(
        n=len(seen),
        n_basins=len(counts),
        n_once=once,
        estimate=once / len(seen) if len(seen) else float("nan"),
        upper=limit,
    )


MAX_SHELLS = 20
N_BINS = 10
# Nine of ten: fifty of fifty starts are enough to be sure of it.
OFTEN = 0.9


@declared
class Radius:
    """The radius within which a start recovers the target with a stated probability."""

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
    """Proportions of starts that recovered a target, by their distance from it."""

    distances: Array = array(
        "Mean distance from the target of the starts in each group, ascending",
        "distance",
        unit=DISTANCE,
        is_in_json=True,
    )
    shares: tuple[Proportion, ...] = entry(
        "Share of the starts in each group that recovered it", rows="distance"
    )

    @property
    @derived("Distance within which nine of ten starts recover it")
    def radius(self) -> Radius:
        """The radius for a probability of 0.9."""
        return radius(self)


def is_recovered(
    searches: SweepSearches, target: Array, *, within: float, polished: bool = False
) -> BoolArray:
    """Which searches ended near the target, shape ``(N,)``.

    Parameters
    ----------
    searches
        The searches.
    target
        Truth or best fit, shape ``(p,)``.
    within
        How far the end may be, as `identknee.identify.sweep.distance` counts: kN
        and %.
    polished
        Whether the polished end is meant, and not that of the optimizer.
    """
    ends = searches.polished if polished else searches.ends
    objectives = searches.polished_objectives if polished else searches.objectives
    near = distance(ends, target, searches.parameters) <= within
    return np.asarray(near & np.isfinite(objectives))


def recovery(distances: Array, recovered: BoolArray) -> Recovery:
    """The proportion recovered at each distance of the starts, or in ten groups of equal size.

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
    """Where a decreasing curve crosses `level`."""
    below = np.flatnonzero(curve < level)
    if below.size == 0:
        return np.inf
    first = int(below[0])
    if first == 0:
        return 0.0
    part = (curve[first - 1] - level) / (curve[first - 1] - curve[first])
    return float(distances[first - 1] + part * (distances[first] - distances[first - 1]))


END, POLISHED = "end", "polished"
WITHIN = 0.5


@declared
class Survey:
    """Searches and their basins, recovery and cliffs."""

    searches: SweepSearches = entry("The searches", group="optimization", is_inline=True)
    basins: Basins = entry(
        "What their polished ends gather to", group="optimization", is_inline=True
    )
    target: Array | None = array(
        "Truth, or the lowest polished end; not there where no search had a prediction",
        "parameter",
        unit=OF_PARAMETER,
        default=None,
    )
    within: float = entry(
        "How close to the target an end has to be to have recovered it", unit=DISTANCE
    )
    recoveries: Mapping[str, Recovery] = entry(
        "How often that happens by the distance of the start, of the search itself (end) and of "
        "its polished end (polished); none without a target",
        rows="end",
        group="recovery",
        key="recovery",
    )

    @property
    @derived("Part of the start volume that leads to basins not seen yet", key="unseen_mass")
    def unseen(self) -> UnseenMass:
        """The unseen mass."""
        return unseen_mass(self.basins.labels)


def survey(
    problem: Problem,
    searches: SweepSearches,
    *,
    target: ArrayLike | None = None,
    within: float = WITHIN,
) -> Survey:
    """Basins, recovery and cliffs seen by many searches.

    Parameters
    ----------
    problem
        That of the searches.
    searches
        From `identknee.identify.sweep.sweep`.
    target
        The truth where it is known, shape ``(p,)``; the lowest polished end if None.
    within
        How close an end has to be, as `identknee.identify.distance` counts: in kN and %.
    """
    basins = find_basins(problem, searches)
    middle = _target(searches, target)
    recoveries: dict[str, Recovery] = {}
    if middle is not None:
        away = distance(searches.starts, middle, searches.parameters)
        for name in (END, POLISHED):
            is_back = is_recovered(searches, middle, within=within, polished=name == POLISHED)
            recoveries[name] = recovery(away, is_back)
    return Survey(
        searches=searches,
        basins=basins,
        target=middle,
        within=within,
        recoveries=recoveries,
    )


def _target(searches: SweepSearches, target: ArrayLike | None) -> Array | None:
    if target is not None:
        return frozen(target, searches.parameters.n, name="the target")
    best = searches.best
    return searches.polished[best] if np.isfinite(searches.polished_objectives[best]) else None
