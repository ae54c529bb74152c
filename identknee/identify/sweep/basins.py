"""Basins of attraction: polished ends of searches that are one minimum."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from identknee.calibrate.evaluation import sum_of_squares
from identknee.calibrate.problem import Problem
from identknee.calibrate.scales import typical_steps
from identknee.identify.shares import Share, share
from identknee.identify.sweep.sweep import Searches
from identknee.runs.arrays import Array, IntArray
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
    share: Share = entry(
        "Share of all starts, failed ones included, whose polished end it is: the volume of the "
        "basin as a part of the volume that the starts fill evenly"
    )


@declared
class Basins:
    """The minima that the polished ends of searches show, the lowest first."""

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

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """One line a basin."""
        lines = [
            f"basin {i}: objective {x.objective:.6g}, {x.share}" for i, x in enumerate(self.basins)
        ]
        return "\n".join(lines or ["no basin was found"])


def find_basins(problem: Problem, searches: Searches) -> Basins:
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


def _joined(problem: Problem, searches: Searches, end: int, leaders: list[int]) -> int | None:
    """Place of the leader that `end` is one minimum with, None if it is one of its own."""
    scales = typical_steps(searches.parameters)
    away = np.max(np.abs(searches.polished[leaders] - searches.polished[end]) / scales, axis=1)
    for place in np.argsort(away, kind="stable")[:N_NEIGHBOURS]:
        if not has_barrier(problem, searches.polished[leaders[place]], searches.polished[end]):
            return int(place)
    return None
