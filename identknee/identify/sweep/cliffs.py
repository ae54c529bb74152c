"""The cliffs of a landscape: where the prediction is lost on the ways from starts to a target."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.evaluation import sum_of_squares
from identknee.calibrate.problem import Problem
from identknee.identify.sweep.starts_design import distance
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, frozen
from identknee.runs.executors import Executor, serial
from identknee.runs.resume import resumable_map
from identknee.runs.store import Store

# Of a way: how fine it is looked at, and how well the edge of a cliff is known.
N_STEPS = 32
EDGE = 1e-4

LostAt = Callable[[Array], Sequence[str]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CliffMap:
    """Straight ways from N starts to a target, and the cliffs on them.

    Attributes
    ----------
    parameters
        Those of the problem.
    target
        Where all ways lead, shape ``(p,)``.
    starts
        Where they begin, shape ``(N, p)``.
    share_lost
        Share of each way without a prediction, shape ``(N,)``, from 32 points on it.
    edges
        The cliff nearest to the target: the last theta with a prediction on the way out from it,
        shape ``(N, p)``; NaN where the way has no cliff.
    edge_distances
        How far it is from the target, as `identknee.identify.sweep.starts_design.distance` counts,
        shape ``(N,)``; NaN likewise.
    lost
        What is lost beyond that edge, by name (trials of a protocol), for each way; empty where
        there is no cliff or it was not asked.
    """

    parameters: Parameters
    target: Array
    starts: Array
    share_lost: Array
    edges: Array
    edge_distances: Array
    lost: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        n, p = len(self.lost), self.parameters.n
        for name, shape in (
            ("target", (p,)),
            ("starts", (n, p)),
            ("share_lost", (n,)),
            ("edges", (n, p)),
            ("edge_distances", (n,)),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))

    @property
    def has_cliff(self) -> BoolArray:
        """Which ways have a cliff on them, shape ``(N,)``."""
        return np.isfinite(self.edge_distances)

    def counts(self) -> dict[str, int]:
        """On how many ways each trial is lost at the cliff nearest to the target, most first."""
        names = [name for way in self.lost for name in way]
        found = {name: names.count(name) for name in dict.fromkeys(names)}
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))


def map_cliffs(
    problem: Problem,
    starts: ArrayLike,
    target: ArrayLike,
    *,
    lost_at: LostAt | None = None,
    executor: Executor = serial,
    store: Store | None = None,
) -> CliffMap:
    """The cliffs on the straight ways from `starts` to `target`.

    Parameters
    ----------
    problem
        Its residuals are infinite where the model has no prediction.
    starts
        Shape ``(N, p)``; each way costs about fifty simulations.
    target
        Truth or best fit, shape ``(p,)``, where the model has a prediction.
    lost_at
        Names of what has no prediction at a theta, such as the trials that do not converge;
        picklable if `executor` runs processes.
    executor
        Anything with an ordered ``map``.
    store
        Where finished ways are kept.

    Raises
    ------
    ValueError
        If the model has no prediction at the target.
    """
    parameters = problem.parameters
    points = frozen(starts, None, parameters.n, name="starts")
    to = frozen(target, parameters.n, name="the target")
    if not _is_predicted(problem, to):
        raise ValueError("the model has no prediction at the target; choose another one")
    task = partial(_way, problem, to, lost_at)
    ways = resumable_map(
        task, points.tolist(), executor=executor, store=store, name="ways", description="cliffs"
    )
    edges = np.array([way["edge"] for way in ways]).reshape(len(ways), parameters.n)
    return CliffMap(
        parameters=parameters,
        target=to,
        starts=points,
        share_lost=np.array([way["share_lost"] for way in ways]),
        edges=edges,
        edge_distances=distance(edges, to, parameters),
        lost=tuple(tuple(way["lost"]) for way in ways),
    )


def plane(problem: Problem, center: Array, axes: tuple[int, int], n: int) -> tuple[Array, Array]:
    """Objectives on a plane through a point, for a picture of basins and cliffs.

    Parameters
    ----------
    problem
        What to evaluate.
    center
        A point of the plane, shape ``(p,)``.
    axes
        The two parameters that vary, each between its bounds; the others stay at the center.
    n
        Values of each.

    Returns
    -------
    values, objectives
        Values of the two parameters, shape ``(2, n)``; half the sum of squares, shape ``(n, n)``,
        second parameter first, infinite without a prediction.
    """
    parameters = problem.parameters
    chosen = list(axes)
    values = np.linspace(parameters.lower[chosen], parameters.upper[chosen], n, axis=-1)
    objectives = np.empty((n, n))
    theta = np.array(center, dtype=np.float64)
    for row, second in enumerate(values[1]):
        for column, first in enumerate(values[0]):
            theta[chosen] = first, second
            objectives[row, column] = 0.5 * sum_of_squares(problem.residuals(theta))
    return values, objectives


def _way(problem: Problem, target: Array, lost_at: LostAt | None, start: Any) -> dict[str, Any]:
    way = np.asarray(start) - target
    along = np.linspace(0.0, 1.0, N_STEPS + 1)[1:]
    is_lost = np.array([not _is_predicted(problem, target + x * way) for x in along])
    if not is_lost.any():
        return {"share_lost": 0.0, "edge": np.full(target.size, np.nan), "lost": []}
    first = int(np.argmax(is_lost))
    inside, outside = along[first] - 1.0 / N_STEPS, along[first]
    while outside - inside > EDGE:
        middle = 0.5 * (inside + outside)
        if _is_predicted(problem, target + middle * way):
            inside = middle
        else:
            outside = middle
    return {
        "share_lost": float(is_lost.mean()),
        "edge": target + inside * way,
        "lost": [] if lost_at is None else list(lost_at(target + outside * way)),
    }


def _is_predicted(problem: Problem, theta: Array) -> bool:
    return bool(np.all(np.isfinite(problem.residuals(theta))))
