"""The searches behind a set of equivalents: each a task that can be resumed, all feeding a pool."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.identify.equivalents.extremum import (
    INSIDE_TOLERANCE,
    End,
    Extreme,
    at_bounds,
    extremise,
    farthest_pair,
)
from identknee.identify.equivalents.rays import longest_axes, points_along
from identknee.identify.equivalents.region import Region, RegionView
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import OF_PARAMETER, OF_QUANTITY, array, declared, entry
from identknee.runs.executors import Executor
from identknee.runs.resume import resumable_map
from identknee.runs.store import Store

AXES, PAIRS, STARTS = 3, 4, 3
RAYS_PER_TASK = 20
BLOCK = 256  # points whose distances from all others are held at once
SIGNS = (-1.0, 1.0)
# Searches that end this close, relative to the quantity's range, agree.
AGREEMENT = 1e-4
Row = dict[str, Any]


@declared
class Extremum:
    """The smallest or the largest value of a quantity over a region."""

    value: float = entry("Value there", unit=OF_QUANTITY)
    end: End = entry("What keeps the quantity from going farther")
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
        "Searches that ended at this value within 0.01 % of the quantity's range; one of many is a "
        "warning: there may be more beyond",
        unit="1",
    )
    theta: Array = array("Parameters there", "parameter", unit=OF_PARAMETER)


class Searches:
    """Searches in one region, their ends and every other simulated point inside kept in a pool.

    Parameters
    ----------
    region
        The region.
    quantities
        Those to find the extrema of.
    executor, store
        As for `identknee.runs.resume.resumable_map`.
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
        self._ends: dict[tuple[int, float], list[Row]] = {}
        self._pairs: list[Row] = []
        self._pool: list[Array] = [region.center]

    @property
    def n_simulations(self) -> int:
        """Simulations of the region's problem made by all searches."""
        return self._n_simulations + self._view.n_simulations

    @property
    def steps(self) -> Array:
        """What distances are counted in, shape ``(n,)``."""
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

    def extremes(self, which: Sequence[int], starts: Array, values: Array, name: str) -> None:
        """Search the smallest and the largest value of some quantities.

        Parameters
        ----------
        which
            Places of the quantities.
        starts, values
            Points inside, shape ``(n_starts, n)``, and all quantities there, shape
            ``(n_starts, n_quantities)``. Searches begin at the first, and at a few others where the
            quantity is lowest or highest.
        name
            Name of the map in the store.
        """
        items: list[Row] = []
        for i in which:
            for sign in SIGNS:
                best = 1 + np.argsort(-sign * values[1:, i], kind="stable")[: STARTS - 1]
                items.append({"quantity": i, "sign": sign, "starts": starts[[0, *best]]})
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
        """Pairs to begin with: where the longest axes of the linear model leave the region."""
        center = self._region.center
        pairs = []
        for axis in longest_axes(self._view, center)[:AXES]:
            ends = [points_along(self._view, center, x, 1.0) for x in (axis, -axis)]
            pair = np.array([found[0] if found else center for found in ends])
            if np.any(pair[0] != pair[1]):
                pairs.append(pair)
        return pairs

    def far_pairs(self) -> list[Array]:
        """Pairs to begin with: points of the pool far apart, each pair with another first point."""
        points = self.pool
        partner, apart = _farthest(points / self.steps)
        found: list[Array] = []
        used: set[int] = set()
        for i in np.argsort(-apart, kind="stable"):
            j = int(partner[i])
            if not {int(i), j} & used and len(found) < PAIRS:
                used |= {int(i), j}
                found.append(points[[i, j]])
        return found

    def doubtful(self) -> list[int]:
        """Places of the quantities of which only one search found an extremum."""
        return [
            i
            for i in range(len(self._quantities))
            if any(self.side(i, sign).n_agreeing < 2 for sign in SIGNS)
        ]

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
            end=End(best["end"]),
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


def _farthest(points: Array) -> tuple[IntArray, Array]:
    """For each point the one farthest from it, and their distance, both shape ``(n,)``."""
    partners, apart = [], []
    for start in range(0, len(points), BLOCK):
        block = cdist(points[start : start + BLOCK], points)
        partners.append(block.argmax(axis=1))
        apart.append(block.max(axis=1))
    return np.concatenate(partners), np.concatenate(apart)
