"""Basins of attraction: polished ends of a sweep that are one minimum."""

from dataclasses import dataclass

import numpy as np

from identknee.calibrate.evaluation import sum_of_squares
from identknee.calibrate.problem import Problem
from identknee.calibrate.scales import typical_steps
from identknee.identify.shares import Share, share
from identknee.identify.sweep.sweep import Sweep
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, IntArray, frozen, frozen_integers

# In typical steps (3 kN, 2 %): ends closer than this in every parameter are one minimum.
TOLERANCE = 0.01
# Points between two minima where a barrier is looked for, and how many minima next to one are
# looked at.
N_BETWEEN = 7
N_NEIGHBOURS = 3
# Share of the deviance, and the deviance itself, below which a barrier is rounding.
BARRIER_SHARE, BARRIER_FLOOR = 1e-6, 2e-9
NONE = -1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Basin:
    """A minimum and the starts that lead to it.

    Attributes
    ----------
    theta
        The minimum, shape ``(p,)``.
    objective
        Half the sum of squares there.
    share
        Of all starts, failed ones included, those whose polished end it is: the volume of the basin
        as a part of the volume that the starts fill evenly.
    """

    theta: Array
    objective: float
    share: Share

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", frozen(self.theta, None, name="theta"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Basins:
    """The minima that the polished ends of a sweep show, the lowest first.

    Attributes
    ----------
    parameters
        Those of the problem.
    basins
        One for each minimum.
    labels
        Place in `basins` of each start, shape ``(N,)``; -1 where its polishing ended at no minimum.
    """

    parameters: Parameters
    basins: tuple[Basin, ...]
    labels: IntArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", frozen_integers(self.labels))

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """One line a basin."""
        lines = [
            f"basin {i}: objective {x.objective:.6g}, {x.share}" for i, x in enumerate(self.basins)
        ]
        return "\n".join(lines or ["no basin was found"])


def find_basins(problem: Problem, sweep: Sweep) -> Basins:
    """The basins among the polished ends of a sweep.

    Ends that polishing calls minima are gathered from the lowest up: those within 0.01 typical
    steps (0.03 kN, 0.02 %) of one in every parameter are that minimum. Two minima with no barrier
    on the straight line between them are one too: where a direction changes nothing, the minimum
    is not a point.

    Parameters
    ----------
    problem
        That of the sweep, to look for barriers; each pair of minima costs seven simulations, the
        starts cost none.
    sweep
        The ends.
    """
    scales = typical_steps(sweep.parameters)
    labels = np.full(sweep.n, NONE, dtype=np.int64)
    leaders: list[int] = []
    left = np.flatnonzero(sweep.is_polished)
    left = left[np.argsort(sweep.polished_objectives[left], kind="stable")]
    while left.size:
        leader = int(left[0])
        away = np.abs(sweep.polished[left] - sweep.polished[leader]) / scales
        near = away.max(axis=1) <= TOLERANCE
        joined = _joined(problem, sweep, leader, leaders)
        if joined is None:
            joined = len(leaders)
            leaders.append(leader)
        labels[left[near]] = joined
        left = left[~near]
    counts = np.bincount(labels[labels != NONE], minlength=len(leaders))
    return Basins(
        parameters=sweep.parameters,
        basins=tuple(
            Basin(
                theta=sweep.polished[leader],
                objective=float(sweep.polished_objectives[leader]),
                share=share(int(count), sweep.n),
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


def _joined(problem: Problem, sweep: Sweep, end: int, leaders: list[int]) -> int | None:
    """Place of the leader that `end` is one minimum with, None if it is one of its own."""
    scales = typical_steps(sweep.parameters)
    away = np.max(np.abs(sweep.polished[leaders] - sweep.polished[end]) / scales, axis=1)
    for place in np.argsort(away, kind="stable")[:N_NEIGHBOURS]:
        if not has_barrier(problem, sweep.polished[leaders[place]], sweep.polished[end]):
            return int(place)
    return None
