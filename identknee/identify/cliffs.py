"""Cliffs: where the equilibrium is lost on straight paths from starts to a target."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.problem import Problem, sum_of_squares
from identknee.identify.sweep import DISTANCE, distance
from identknee.runs.declare import OF_PARAMETER, Array, BoolArray, array, declared, derived, frozen
from identknee.runs.executors import Executor, serial
from identknee.runs.store import Store, resumable_map

# Points on a path, and the tolerance of the edge of a cliff as a share of the path.
N_STEPS = 32
EDGE = 1e-4

LostAt = Callable[[Array], Sequence[str]]


@declared
class CliffMap:
    """Straight paths from N starts to a target, and the cliffs on them."""

    target: Array = array("Where all paths lead", "parameter", unit=OF_PARAMETER)
    starts: Array = array(
        "Where they begin", *("path", "parameter"), unit=OF_PARAMETER, key="theta_start"
    )
    share_lost: Array = array(
        "Share of each path without a prediction, from 32 points on it", "path"
    )
    edges: Array = array(
        "The cliff nearest to the target: last theta with a prediction on the way out from it; "
        "NaN where the path has no cliff",
        *("path", "parameter"),
        unit=OF_PARAMETER,
        key="theta_edge",
    )
    edge_distances: Array = array(
        "Distance of that cliff from the target; NaN where the path has none",
        "path",
        unit=DISTANCE,
        key="edge_distance",
    )
    trials: tuple[str, ...] = array(
        "Names of what is lost beyond an edge, such as trials", "lost_trial", is_in_arrays=False
    )
    is_lost: BoolArray = array(
        "Whether each of them is lost beyond the edge of a path", "path", "lost_trial", dtype=bool
    )

    @property
    def has_cliff(self) -> BoolArray:
        """Which paths have a cliff on them, shape ``(N,)``."""
        return np.isfinite(self.edge_distances)

    @property
    @derived("Straight paths from starts to the target", unit="1")
    def n_paths(self) -> int:
        return len(self.starts)

    @property
    @derived("Paths with a cliff on them", unit="1")
    def n_paths_with_cliff(self) -> int:
        return int(self.has_cliff.sum())

    @property
    @derived("Least distance of a cliff from the target; null without one", unit=DISTANCE)
    def nearest_distance(self) -> float | None:
        distances = self.edge_distances[self.has_cliff]
        return float(distances.min()) if distances.size else None

    @property
    @derived("Median distance of the nearest cliffs; null without one", unit=DISTANCE)
    def median_distance(self) -> float | None:
        distances = self.edge_distances[self.has_cliff]
        return float(np.median(distances)) if distances.size else None

    @property
    @derived("Paths on which each trial is lost at the nearest cliff, most first", unit="1")
    def trials_lost(self) -> dict[str, int]:
        numbers = dict(zip(self.trials, self.is_lost.sum(axis=0).tolist(), strict=True))
        return dict(sorted(numbers.items(), key=lambda pair: -pair[1]))


def map_cliffs(
    problem: Problem,
    starts: ArrayLike,
    target: ArrayLike,
    *,
    lost_at: LostAt | None = None,
    executor: Executor = serial,
    store: Store | None = None,
) -> CliffMap:
    """The cliffs on the straight paths from `starts` to `target`.

    Parameters
    ----------
    problem
        Problem whose residuals are infinite where the model has no prediction.
    starts
        Shape ``(N, p)``; each path costs about fifty simulations.
    target
        Truth or best fit, shape ``(p,)``, where the model has a prediction.
    lost_at
        Names of what has no prediction at a theta, such as the trials that do not converge;
        picklable if `executor` runs processes.
    executor
        Anything with an ordered ``map``.
    store
        Where finished paths are kept.

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
    task = partial(_path, problem, to, lost_at)
    paths = resumable_map(
        task, points.tolist(), executor=executor, store=store, name="paths", description="cliffs"
    )
    edges = np.array([path["edge"] for path in paths]).reshape(len(paths), parameters.n)
    trials = tuple(dict.fromkeys(name for path in paths for name in path["lost"]))
    return CliffMap(
        target=to,
        starts=points,
        share_lost=np.array([path["share_lost"] for path in paths]),
        edges=edges,
        edge_distances=distance(edges, to, parameters),
        trials=trials,
        is_lost=np.reshape(
            [x in path["lost"] for path in paths for x in trials], (len(paths), len(trials))
        ),
    )


def plane(problem: Problem, center: Array, axes: tuple[int, int], n: int) -> tuple[Array, Array]:
    """Objectives on a plane through a point, for a figure of basins and cliffs.

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


def _path(problem: Problem, target: Array, lost_at: LostAt | None, start: Any) -> dict[str, Any]:
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
