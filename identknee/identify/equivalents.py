"""Parameter sets that a measurement cannot distinguish, and the ranges over them."""

from collections.abc import Callable, Mapping, Sequence
from enum import unique
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist, pdist

from identknee.calibrate.problem import ParameterQuantity, Quantity, unpredicted
from identknee.identify.region import (
    INSIDE_TOLERANCE,
    Blocks,
    Extreme,
    ExtremumEnd,
    Region,
    RegionView,
    at_bounds,
    extremise,
    farthest_pair,
)
from identknee.runs.declare import (
    OF_PARAMETER,
    OF_QUANTITY,
    Array,
    IntArray,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.executors import Executor, serial, spawn_seeds
from identknee.runs.record import WithSentence
from identknee.runs.store import Store, resumable_map

# A point this close to the limit is on the boundary of the region, for a ray.
BOUNDARY = 0.9
TARGET = 0.97
MOST_TRIALS = 6
# Share of the box beyond which no semi-axis of the linear model reaches.
BOX_PART = 0.5


def longest_axes(view: RegionView, theta: Array) -> Array:
    """Semi-axes of the ellipsoid that the region's linear model makes at a point, ``(n, n)``.

    They come from the longest to the shortest. Along directions that the predictions do not depend
    on they reach as far as the box. Where there are several blocks the ellipsoid is that of their
    sum.
    """
    steps = view.steps
    slopes = view(theta).slopes * steps
    _, size, right = np.linalg.svd(slopes.reshape(-1, steps.size), full_matrices=False)
    widest = BOX_PART * float(np.max((view.upper - view.lower) / steps))
    return np.asarray(steps * right / np.hypot(size, 1.0 / widest)[:, None])[::-1]


def points_along(view: RegionView, origin: Array, direction: Array, share: float) -> list[Array]:
    """The last point inside on a ray and one between it and the origin, simulated; or fewer.

    Parameters
    ----------
    view
        The region.
    origin
        A point inside, shape ``(n,)``.
    direction
        The ray, shape ``(n,)``, of any length; turned back where it leads out at once.
    share
        Where the point between stands: 0 at the origin, 1 at the other.
    """
    blocks = view(origin)
    uphill = np.einsum("bki,bk->bi", blocks.slopes, blocks.offsets)[np.argmax(blocks.values)]
    if blocks.largest > BOUNDARY and uphill @ direction > 0:
        direction = -direction
    reach = _reach(blocks, direction)
    # Distance to the bounds along the direction.
    wall = np.where(direction > 0, view.upper, view.lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        lengths = (wall - origin) / direction
    longest = float(np.min(np.where(direction == 0.0, np.inf, lengths)))
    low, high = 0.0, np.inf
    last: Array | None = None
    for _ in range(MOST_TRIALS):
        length = min(low + reach, longest)
        if length >= high:
            length = 0.5 * (low + high)
        theta = np.clip(origin + length * direction, view.lower, view.upper)
        blocks = view(theta)
        if blocks.largest > 1.0:
            high = length
            reach = 0.5 * (high - low)
            continue
        low, last = length, theta
        if blocks.largest > BOUNDARY or length == longest:
            break
        reach = _reach(blocks, direction)
    if last is None:
        return []
    between = origin + share * (last - origin)
    return [last, between] if view(between).largest <= 1.0 else [last]


def farthest_first(points: Array, first: IntArray, n: int, least: float) -> IntArray:
    """Which of the points to take so that each is as far from those before it as can be.

    Parameters
    ----------
    points
        Shape ``(n_points, p)``, in units in which distance is Euclidean.
    first
        Those to begin with.
    n
        How many to take.
    least
        The least distance between two; there may be fewer than `n` then.

    References
    ----------
    T. F. Gonzalez, Clustering to minimize the maximum intercluster distance, Theoretical Computer
    Science 38 (1985) 293-306, doi:10.1016/0304-3975(85)90224-5: no choice of as many of these
    points has a smallest distance more than twice as large.

    Examples
    --------
    >>> line = np.array([[0.0], [0.9], [0.5], [1.0]])
    >>> farthest_first(line, np.array([0, 3]), 3, 0.2)
    array([0, 3, 2])
    """
    chosen = [int(i) for i in first]
    distance = np.min([np.linalg.norm(points - points[i], axis=1) for i in chosen], axis=0)
    while len(chosen) < n:
        next_one = int(np.argmax(distance))
        if distance[next_one] < least:
            break
        chosen.append(next_one)
        distance = np.minimum(distance, np.linalg.norm(points - points[next_one], axis=1))
    return np.array(chosen, dtype=np.int64)


def _reach(blocks: Blocks, direction: Array) -> float:
    """Distance along the direction at which the linear model leaves the region; inf if never."""
    slope = blocks.slopes @ direction
    square = np.einsum("bk,bk->b", slope, slope)
    half = np.einsum("bk,bk->b", slope, blocks.offsets)
    room = np.maximum(TARGET - blocks.values, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = (np.sqrt(half**2 + square * room) - half) / square
    return float(np.min(np.where(square > 0, roots, np.inf)))


AXES, PAIRS, STARTS = 3, 4, 3
RAYS_PER_TASK = 20
BLOCK = 256  # points per block of distances, which bounds the memory
SIGNS = (-1.0, 1.0)
# Searches that end this close, relative to the quantity's range, agree.
AGREEMENT = 1e-3
Row = dict[str, Any]
# The place of a quantity, and the sign of its extremum.
Side = tuple[int, float]


@declared
class Extremum:
    """The smallest or the largest value of a quantity over a region."""

    value: float = entry("Value there", unit=OF_QUANTITY)
    end: ExtremumEnd = entry("What keeps the quantity from going farther")
    at_bounds: tuple[str, ...] = entry(
        "Parameters on their bounds there: the value holds for this box"
    )
    distance: float = entry(
        "Largest block there, in the units of the limit: simulated, and at most a millionth above "
        "the limit",
        unit="1",
    )
    n_searches: int = entry("Searches from different starts", unit="1")
    n_agreeing: int = entry(
        "Searches that ended at this value within 0.1 % of the quantity's range; one of many is a "
        "warning: there may be more beyond",
        unit="1",
    )
    theta: Array = array("Parameters there", "parameter", unit=OF_PARAMETER)


class RegionSearches:
    """Searches in one region, their ends and every other simulated point inside kept in a pool.

    Parameters
    ----------
    region
        The region.
    quantities
        Those to find the extrema of.
    executor, store
        As for `identknee.runs.store.resumable_map`.
    """

    def __init__(
        self,
        region: Region,
        quantities: Sequence[Quantity],
        executor: Executor,
        store: Store | None,
    ) -> None:
        self._region = region
        self._quantities = tuple(quantities)
        self._executor = executor
        self._store = store
        self._view = RegionView(region)
        self._n_simulations = 0
        self._ends: dict[Side, list[Row]] = {}
        self._pairs: list[Row] = []
        self._pool: list[Array] = [region.center]

    @property
    def n_simulations(self) -> int:
        """Simulations of the region's problem made by all searches."""
        return self._n_simulations + self._view.n_simulations

    @property
    def steps(self) -> Array:
        """The unit of distance in each parameter, shape ``(n,)``."""
        return self._view.steps

    @property
    def pool(self) -> Array:
        """All points known to be inside, the fit first, shape ``(n_points, n)``."""
        return np.array(self._pool)

    @property
    def pair_distances(self) -> Array:
        """Where the searches for the farthest pair ended, from the largest down."""
        return -np.sort([-float(row["value"]) for row in self._pairs])

    @property
    def farthest_pair(self) -> tuple[float, Array]:
        """The diameter in steps, and its two ends, shape ``(2, n)``."""
        best = max(self._pairs, key=lambda row: float(row["value"]))
        return float(best["value"]), np.array(best["theta"]).reshape(2, -1)

    def extremes(self, which: Sequence[Side], starts: Array, values: Array, name: str) -> None:
        """Search the smallest or the largest value of some quantities.

        Parameters
        ----------
        which
            Places of the quantities, each with the sign of what is searched.
        starts, values
            Points inside, shape ``(n_starts, n)``, and all quantities there, shape
            ``(n_starts, n_quantities)``. Searches begin at the first unless one did before, and at
            a few others where the quantity is lowest or highest.
        name
            Name of the map in the store.
        """
        items: list[Row] = []
        for i, sign in which:
            first = [] if (i, sign) in self._ends else [0]
            best = 1 + np.argsort(-sign * values[1:, i], kind="stable")[: STARTS - 1]
            items.append({"quantity": i, "sign": sign, "starts": starts[[*first, *best]]})
        rows = self._map(_search_extreme, items, name, "finding extrema")
        for item, row in zip(items, rows, strict=True):
            self._n_simulations += row["n_simulations"]
            ends = self._ends.setdefault((item["quantity"], item["sign"]), [])
            ends += [end for end in row["ends"] if end["largest"] <= 1.0 + INSIDE_TOLERANCE]
            self._pool += [np.array(theta) for end in row["ends"] for theta in end["path"]]

    def pairs(self, starts: Sequence[Array], name: str) -> None:
        """Search the two points farthest apart, from pairs to start at, shape ``(2, n)`` each."""
        for row in self._map(_search_pair, starts, name, "finding the diameter"):
            self._n_simulations += row["n_simulations"]
            if row["largest"] <= 1.0 + INSIDE_TOLERANCE:
                self._pairs.append(row)
            self._pool += list(np.array(row["path"]).reshape(-1, self.steps.size))

    def rays(self, origins: Array, n: int, seed: np.random.SeedSequence, name: str) -> None:
        """Look along `n` random rays from points inside, drawn from `origins`.

        Their directions are uniform on the ellipsoid of the linear model there.
        """
        generator = np.random.default_rng(seed)
        turns = generator.standard_normal((n, origins.shape[1]))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        drawn = origins[generator.integers(len(origins), size=n)]
        shares = generator.uniform(size=n)
        items = [
            {"origins": drawn[part], "turns": turns[part], "shares": shares[part]}
            for part in np.array_split(np.arange(n), -(-n // RAYS_PER_TASK))
        ]
        for row in self._map(_search_rays, items, name, "looking along rays"):
            self._n_simulations += row["n_simulations"]
            self._pool += [np.array(theta) for theta in row["points"]]

    def measured(self, points: Array, name: str) -> tuple[Array, Array]:
        """Blocks, shape ``(n_points, n_blocks)``, and quantities of points simulated once more."""
        rows = self._map(_measure, list(points), name, "simulating sets")
        self._n_simulations += sum(row["n_simulations"] for row in rows)
        blocks = np.array([row["blocks"] for row in rows])
        return blocks, np.array([row["quantities"] for row in rows])

    def axis_pairs(self) -> list[Array]:
        """Initial pairs: where the longest axes of the linear model leave the region."""
        center = self._region.center
        pairs = []
        for axis in longest_axes(self._view, center)[:AXES]:
            ends = [points_along(self._view, center, x, 1.0) for x in (axis, -axis)]
            pair = np.array([found[0] if found else center for found in ends])
            if np.any(pair[0] != pair[1]):
                pairs.append(pair)
        return pairs

    def far_pairs(self) -> list[Array]:
        """Initial pairs: points of the pool far apart, each with another first point."""
        points = self.pool
        # For each point the one farthest from it, and their distance, both shape ``(n,)``.
        scaled = points / self.steps
        partner, apart = np.zeros(len(scaled), dtype=np.int64), np.zeros(len(scaled))
        for start in range(0, len(scaled), BLOCK):
            some = slice(start, start + BLOCK)
            block = cdist(scaled[some], scaled)
            partner[some], apart[some] = block.argmax(axis=1), block.max(axis=1)
        found: list[Array] = []
        used: set[int] = set()
        for i in np.argsort(-apart, kind="stable"):
            j = int(partner[i])
            if not {int(i), j} & used and len(found) < PAIRS:
                used |= {int(i), j}
                found.append(points[[i, j]])
        return found

    def doubtful(self) -> list[Side]:
        """The extrema that only one search found."""
        return [side for side in self._ends if self.side(*side).n_agreeing < 2]

    def exceeded(self, values: Array) -> list[Side]:
        """The extrema that points inside lie beyond, all quantities there given."""
        found = []
        for i, sign in self._ends:
            low, high = (self.side(i, x).value for x in SIGNS)
            beyond = sign * values[:, i] - max(sign * low, sign * high)
            if np.nanmax(beyond, initial=-np.inf) > INSIDE_TOLERANCE * (high - low):
                found.append((i, sign))
        return found

    def side(self, quantity: int, sign: float) -> Extremum:
        """The smallest (sign -1) or largest (1) value that the searches found."""
        ends = self._ends[quantity, sign]
        best = max(ends, key=lambda end: sign * float(end["value"]))
        others = [end["value"] for end in self._ends[quantity, -sign]]
        scale = abs(best["value"] - (min(others) if sign > 0 else max(others)))
        theta = np.array(best["theta"])
        names = np.array(self._region.problem.parameters.names)
        return Extremum(
            value=best["value"],
            theta=theta,
            distance=best["largest"] * self._region.limit,
            end=ExtremumEnd(best["end"]),
            at_bounds=tuple(names[at_bounds(theta, self._view)].tolist()),
            n_searches=len(ends),
            n_agreeing=sum(abs(x["value"] - best["value"]) <= AGREEMENT * scale for x in ends),
        )

    def _map(
        self, function: Callable[..., Row], items: Sequence[Any], name: str, description: str
    ) -> list[Row]:
        return resumable_map(
            partial(function, self._region, self._quantities),
            items,
            executor=self._executor,
            store=self._store,
            name=name,
            description=description,
        )


def _search_extreme(region: Region, quantities: tuple[Quantity, ...], item: Row) -> Row:
    view = RegionView(region)
    quantity = quantities[item["quantity"]]
    ends = [
        _as_row(extremise(view, quantity, start, sign=item["sign"]))
        for start in np.asarray(item["starts"])
        if np.isfinite(quantity.evaluate(start)[0])
    ]
    return {"ends": ends, "n_simulations": _simulations(view, [quantity])}


def _search_pair(region: Region, _: tuple[Quantity, ...], item: Array) -> Row:
    view = RegionView(region)
    row = _as_row(farthest_pair(view, item[0], item[1]))
    return row | {"n_simulations": view.n_simulations}


def _search_rays(region: Region, _: tuple[Quantity, ...], item: Row) -> Row:
    view = RegionView(region)
    points = [
        found
        for origin, turn, share in zip(item["origins"], item["turns"], item["shares"], strict=True)
        for found in points_along(view, origin, turn @ longest_axes(view, origin), share)
    ]
    return {"points": points, "n_simulations": view.n_simulations}


def _measure(region: Region, quantities: tuple[Quantity, ...], point: Array) -> Row:
    view = RegionView(region)
    return {
        "blocks": view(point).values * region.limit,
        "quantities": [quantity.evaluate(point)[0] for quantity in quantities],
        "n_simulations": _simulations(view, quantities),
    }


def _simulations(view: RegionView, quantities: Sequence[Quantity]) -> int:
    """Those of the view, and as many again for quantities other than parameters, at the most."""
    is_own = all(isinstance(x, ParameterQuantity) for x in quantities)
    return view.n_simulations * (1 if is_own else 2)


def _as_row(extreme: Extreme) -> Row:
    return {
        "value": extreme.value,
        "theta": extreme.theta,
        "largest": extreme.largest,
        "end": extreme.end.value,
        "path": extreme.path,
    }


# No two sets closer than this part of the diameter.
SEPARATION = 0.02
RAYS_PER_SET, MOST_ROUNDS = 2, 3


@unique
class Completeness(WithSentence):
    """Whether as many sets were found as asked for; the value is the word written to files."""

    COMPLETE = ("complete", "All requested sets were found.")
    FEWER = ("fewer", "The region contains fewer sufficiently different sets than requested.")


@declared
class Extrema:
    """The range of one quantity over a region."""

    name: str = entry("Name of the quantity")
    unit: str = entry("Unit of the quantity")
    at_fit: float = entry("Value at the fit", unit=OF_QUANTITY, key="fit")
    lower: Extremum = entry("What was found of the smallest value", key="lower_side")
    upper: Extremum = entry("What was found of the largest value", key="upper_side")

    @property
    @derived("Smallest value over the region", unit=OF_QUANTITY, key="lower")
    def smallest(self) -> float:
        return self.lower.value

    @property
    @derived("Largest value over the region", unit=OF_QUANTITY, key="upper")
    def largest(self) -> float:
        return self.upper.value


@declared
class EquivalentSets:
    """Parameter sets equivalent to a fit, as different from one another as possible."""

    outcome: Completeness = entry("Whether there are as many sets as asked for")
    limit: float = entry("Largest value of a block", unit="1")
    blocks: tuple[str, ...] = array("Names of the blocks", "block", is_in_arrays=False)
    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    parameters: Mapping[str, Extrema] = entry(
        "Range of each parameter by its name", rows="ranged_parameter", group="parameter_ranges"
    )
    quantities: Mapping[str, Extrema] = entry(
        "Range of each other quantity by its name", rows="quantity", group="quantity_ranges"
    )
    diameter: float = entry(
        "Largest distance of two points of the region, by constrained maximisation",
        unit="typical steps",
    )
    n_simulations: int = entry("Simulations made, each with its Jacobian", unit="1")
    seed: int = entry("Seed of the random rays", unit="1")
    fit: Array = array("Theta of the fit", "parameter", unit=OF_PARAMETER)
    sets: Array = array(
        "Theta of each set, in the order chosen: the two farthest apart, then always the one "
        "farthest from all before it",
        *("set", "parameter"),
        unit=OF_PARAMETER,
        key="theta",
    )
    distances: Array = array(
        "Value of every block at every set, simulated", "set", "block", key="distance"
    )
    quantity_values: Array = array(
        "Value of every quantity but the parameters at every set",
        *("set", "quantity"),
        unit=OF_QUANTITY,
    )
    steps: Array = array(
        "Typical step of each parameter, in which distances between sets are counted: 3 kN, 2 % or "
        "the prior's sd",
        "parameter",
        unit=OF_PARAMETER,
        key="step",
    )
    pair: Array = array(
        "The two points that far apart",
        *("member", "parameter"),
        unit=OF_PARAMETER,
        key="farthest_pair",
    )
    pair_searches: Array = array(
        "Distances at which the searches for them ended, from the largest down",
        "search",
        unit="typical steps",
        key="pair_search",
    )

    @property
    def extrema(self) -> tuple[Extrema, ...]:
        """All ranges, those of parameters first."""
        return (*self.parameters.values(), *self.quantities.values())

    @property
    @derived("What the outcome means")
    def sentence(self) -> str:
        return self.outcome.sentence

    @property
    @derived("Parameter sets found", unit="1")
    def n_sets(self) -> int:
        return len(self.sets)

    @property
    @derived("Largest value of a block at any set", unit="1")
    def largest_distance(self) -> float:
        return float(self.distances.max())

    @property
    @derived("Largest distance of two sets", unit="typical steps")
    def farthest(self) -> float:
        return float(pdist(self.sets / self.steps).max())

    @property
    @derived("Smallest distance of two sets", unit="typical steps")
    def closest(self) -> float:
        return float(pdist(self.sets / self.steps).min())


def equivalents(
    region: Region,
    *,
    quantities: Sequence[Quantity] = (),
    n_sets: int = 100,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> EquivalentSets:
    """Maximally different parameter sets of a region, and the extrema of quantities over it.

    Constrained searches with exact derivatives find the smallest and largest value of every
    parameter and quantity and the two points farthest apart, from several starts each: the fit,
    the axes of the linear model, and the best of the points found along random rays. From all
    these points the sets are chosen farthest first, and simulated once more.

    Parameters
    ----------
    region
        What counts as equivalent; from `noise_region`, or with blocks of one's own.
    quantities
        What to bound beside the parameters, for example ligament forces.
    n_sets
        How many sets, at least 2.
    seed
        Seed of the random rays.
    executor
        Anything with an ordered ``map``; the result is the same whichever it is.
    store
        Where finished searches are kept, from `identknee.runs.store.open_work`.

    Raises
    ------
    ValueError
        If fewer than 2 sets are asked for, or the model or a quantity has no prediction at the fit.
    """
    if n_sets < 2:
        raise ValueError(f"the number of sets must be at least 2, got {n_sets}")
    parameters = region.problem.parameters
    own = [ParameterQuantity(parameters=parameters, name=name) for name in parameters.names]
    searches = RegionSearches(region, [*own, *quantities], executor, store)
    everything = [(i, sign) for i in range(len(own) + len(quantities)) for sign in SIGNS]
    fit = searches.pool
    at_fit = searches.measured(fit, "fit")[1]
    for quantity, value in zip(quantities, at_fit[0, parameters.n :], strict=True):
        if not np.isfinite(value):
            raise unpredicted(quantity)
    searches.extremes(everything[: 2 * parameters.n], fit, at_fit, "first extrema")
    searches.pairs(searches.axis_pairs() + searches.far_pairs(), "first pairs")
    chosen = origins = fit
    for number, round_seed in enumerate(spawn_seeds(seed, MOST_ROUNDS)):
        searches.rays(origins, RAYS_PER_SET * n_sets, round_seed, f"rays {number}")
        starts = np.vstack([fit, _spread(searches, n_sets)])
        values = searches.measured(starts, f"starts {number}")[1]
        which = searches.doubtful() if number else everything
        searches.extremes(which, starts, values, f"extrema {number}")
        searches.pairs(searches.far_pairs(), f"pairs {number}")
        chosen, origins = _spread(searches, n_sets), searches.pool
        if number and len(chosen) == n_sets:
            break
    blocks, values = searches.measured(chosen, "sets")
    if beyond := searches.exceeded(values):
        searches.extremes(beyond, np.vstack([fit, chosen]), np.vstack([at_fit, values]), "beyond")
    diameter, pair = searches.farthest_pair
    return EquivalentSets(
        parameter_names=parameters.names,
        parameters=_extrema(searches, own, at_fit[0]),
        quantities=_extrema(searches, quantities, at_fit[0], parameters.n),
        fit=region.center,
        limit=region.limit,
        blocks=tuple(region.blocks),
        sets=chosen,
        distances=blocks,
        quantity_values=values[:, parameters.n :],
        steps=searches.steps,
        diameter=diameter,
        pair=pair,
        pair_searches=searches.pair_distances,
        outcome=Completeness.COMPLETE if len(chosen) == n_sets else Completeness.FEWER,
        n_simulations=searches.n_simulations,
        seed=seed,
    )


def _spread(searches: RegionSearches, n: int) -> Array:
    """Points of the pool far from one another, the farthest pair first, shape ``(<= n, p)``."""
    diameter, pair = searches.farthest_pair
    points = np.vstack([pair, searches.pool])
    chosen = farthest_first(points / searches.steps, np.arange(2), n, SEPARATION * diameter)
    return np.asarray(points[chosen])


def _extrema(
    searches: RegionSearches, quantities: Sequence[Quantity], at_fit: Array, first: int = 0
) -> dict[str, Extrema]:
    """Ranges by name of quantities that stand together among those searched."""
    return {
        quantity.name: Extrema(
            name=quantity.name,
            unit=quantity.unit,
            at_fit=float(at_fit[i]),
            lower=searches.side(i, -1.0),
            upper=searches.side(i, 1.0),
        )
        for i, quantity in enumerate(quantities, first)
    }
