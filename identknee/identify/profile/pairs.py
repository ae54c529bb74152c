"""The joint profile of a pair of parameters."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import Evaluator, ParameterQuantity, Problem, typical_steps
from identknee.identify.profile.result import SideStatus, chi2_threshold, crossings, threshold_below
from identknee.identify.profile.walk import BetterOptimumFound, ProfileContext, march
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.declare import OF_PARAMETER, Array, array, declared, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.store import Store, resumable_map

# Simulations along one ray.
BUDGET = 4000
N_RAYS = 24
RADIUS = "radius"
MOST_ROUNDS = 4
# Predicted reduction of the deviance that the optimum may leave.
OPTIMUM_TOLERANCE = 1e-6
# Added to the covariance, in squared typical steps, so that it is positive definite.
SMALLEST = 1e-12


@declared
class PairRay:
    """The profile of a pair along one straight path from its optimum."""

    values: Array = array("The pair at each point, from the optimum outward", "point", "member")
    deltas: Array = array("Rise of the deviance there", "point")
    slopes: Array = array("Derivative of that rise by the distance from the optimum", "point")
    distances: Array = array(
        "Distance from the optimum, in units that turn the pair's confidence set into a circle",
        "point",
    )
    status: SideStatus = entry("How the path ended; closed at the threshold")
    end: Array = array("Last pair of the set, or the last one tried where it is open", "member")


@declared
class PairProfile:
    """The joint confidence set of two parameters, as rays from the best pair."""

    names: tuple[str, str] = entry("Names of the two parameters", key="parameters")
    level: float = entry("Confidence level of the set for both at once", unit="1")
    threshold: float = entry("Rise of the deviance that bounds the set", unit="1")
    optimum: Array = array("The best pair", "member", unit=OF_PARAMETER)
    rays: tuple[PairRay, ...] = entry(
        "Paths outward, counterclockwise in units that turn the set into a circle; what lies "
        "behind an excluded stretch of a path is not seen",
        rows="ray",
    )
    n_simulations: int = entry("Simulations made, each with its Jacobian", unit="1")

    def contour(self, level: float) -> Array:
        """The contour of the joint set at a level up to the profile's own, ``(n_rays, 2)``.

        A row is NaN where the ray does not reach that level.

        Raises
        ------
        ValueError
            If the level is not above 0 or is above the profile's own.
        """
        threshold = threshold_below(self.threshold, self.level, level, 2)
        return np.array([self._crossing(ray, threshold) for ray in self.rays])

    def _crossing(self, ray: PairRay, threshold: float) -> Array:
        if ray.status is SideStatus.CLOSED and threshold >= self.threshold:
            return ray.end
        found = crossings(ray.distances, ray.deltas, ray.slopes, threshold)
        if not found:
            return np.full(2, np.nan)
        last = ray.values[-1] - self.optimum
        return np.asarray(self.optimum + last * (found[0] / ray.distances[-1]))


def profile_pair(
    problem: Problem,
    optimum_theta: ArrayLike,
    names: tuple[str, str],
    *,
    level: float = 0.95,
    threshold: float | None = None,
    executor: Executor = serial,
    store: Store | None = None,
) -> PairProfile:
    """The joint profile of two parameters, all others refitted.

    The set's edge is solved for along 24 straight paths from the optimum, evenly spread in units of
    the pair's covariance, each as one side of a profile of a single quantity.

    Parameters
    ----------
    problem
        Residuals in units of their noise; picklable if `executor` runs processes.
    optimum_theta
        The best fit known, shape ``(n,)``.
    names
        Names of the two parameters.
    level
        Confidence level of the set for both at once.
    threshold
        Rise of the deviance that bounds it; that of the chi-squared law with two degrees of
        freedom if None.
    executor
        Anything with an ordered ``map``.
    store
        Where finished paths are kept; from `identknee.runs.store.open_work`.

    Raises
    ------
    ValueError
        If the names are not those of two different parameters, the level is not between 0 and 1,
        or the model has no prediction at the optimum.
    """
    parameters = problem.parameters
    pair = parameters.index(names[0]), parameters.index(names[1])
    if pair[0] == pair[1]:
        raise ValueError(f"a pair needs two different parameters, got {names[0]} twice")
    threshold = chi2_threshold(level, 2) if threshold is None else threshold
    theta = np.asarray(optimum_theta, dtype=np.float64)
    directions = np.linspace(0.0, 2.0 * np.pi, N_RAYS, endpoint=False).tolist()
    n_simulations = 0
    for round_ in range(MOST_ROUNDS):
        evaluator = Evaluator(problem)
        optimum = minimise(evaluator, theta, tolerance=OPTIMUM_TOLERANCE).evaluation
        if not optimum.is_finite:
            raise ValueError("the model has no prediction at the optimum given; fit it first")
        shape = _shape(optimum.jacobian, parameters, pair)
        is_last = round_ == MOST_ROUNDS - 1
        rows = resumable_map(
            partial(_ray, problem, optimum.theta, pair, shape, (threshold, is_last)),
            directions,
            executor=executor,
            store=store,
            name=f"pair {names[0]} {names[1]} round {round_}",
            description=f"profiling {names[0]} with {names[1]}",
        )
        n_simulations += evaluator.n_simulations + sum(x["n_simulations"] for x in rows)
        better = [x for x in rows if x["better"] is not None]
        if not better:
            break
        theta = np.array(min(better, key=lambda x: float(x["deviance"]))["better"])
    return PairProfile(
        names=(names[0], names[1]),
        level=level,
        threshold=threshold,
        optimum=optimum.theta[list(pair)],
        rays=tuple(_as_ray(x, optimum.theta[list(pair)]) for x in rows),
        n_simulations=n_simulations,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RayProblem:
    """A problem in which two parameters vary together along a ray.

    Attributes
    ----------
    problem
        The problem.
    origin
        Theta where the ray begins, shape ``(n,)``.
    pair
        Places of the two parameters in theta.
    direction
        Change of the two per unit of distance, shape ``(2,)``.
    """

    problem: Problem
    origin: Array
    pair: tuple[int, int]
    direction: Array

    @property
    def parameters(self) -> Parameters:
        """The distance from the origin, then the parameters other than the pair."""
        everything = self.problem.parameters
        others = self.others.parameters
        # Length of the ray within the bounds.
        lengths = [np.inf]
        for i, change in zip(self.pair, self.direction, strict=True):
            bound = everything.upper[i] if change > 0 else everything.lower[i]
            if change != 0.0:
                lengths.append((bound - self.origin[i]) / change)
        # Bounds must differ, so the ray of an optimum on a bound keeps a negligible length.
        farthest = max(float(min(lengths)), np.finfo(np.float64).tiny)
        return Parameters(
            names=(RADIUS, *others.names),
            center=np.r_[0.0, others.center],
            lower=np.r_[0.0, others.lower],
            upper=np.r_[farthest, others.upper],
            prior_sd=np.r_[1.0, others.prior_sd],
            is_nuisance=np.r_[False, ~others.is_of_interest],
            is_log=np.r_[False, others.is_log],
        )

    @property
    def others(self) -> FreeParameters:
        """The parameters other than the pair."""
        everything = self.problem.parameters
        return everything.with_fixed([everything.names[i] for i in self.pair], self.origin)

    def residuals(self, theta: Array) -> Array:
        """Residuals of the problem, shape ``(m,)``."""
        return self.problem.residuals(self.expand(theta))

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by the distance and the other parameters, shape ``(m, n - 1)``."""
        jacobian = self.problem.jacobian(self.expand(theta))
        along = jacobian[:, list(self.pair)] @ self.direction
        return np.column_stack([along, self.others.restrict(jacobian)])

    def expand(self, theta: Array) -> Array:
        """Theta of the problem, shape ``(n,)``."""
        everything = self.others.expand(theta[1:])
        everything[list(self.pair)] += theta[0] * self.direction
        parameters = self.problem.parameters
        return np.asarray(np.clip(everything, parameters.lower, parameters.upper))


def _shape(jacobian: Array, parameters: Parameters, pair: tuple[int, int]) -> Array:
    """The matrix (2, 2) that maps the unit circle to the pair's ellipse of equal deviance.

    Directions that the data do not see are cut off at the parameters' typical steps.
    """
    scales = typical_steps(parameters)
    _, size, directions = np.linalg.svd(jacobian * scales, full_matrices=True)
    known = np.zeros(parameters.n)
    known[: size.size] = size
    spread = 1.0 / np.maximum(known, 1.0)
    rows = (directions.T * spread)[list(pair)] * scales[list(pair), None]
    covariance = rows @ rows.T
    covariance += SMALLEST * np.diag(scales[list(pair)] ** 2)
    return np.asarray(np.linalg.cholesky(covariance))


def _ray(
    problem: Problem,
    theta: Array,
    pair: tuple[int, int],
    shape: Array,
    settings: tuple[float, bool],
    angle: float,
) -> dict[str, Any]:
    threshold, is_last = settings
    direction = shape @ np.array([np.cos(angle), np.sin(angle)])
    along = RayProblem(problem=problem, origin=theta, pair=pair, direction=direction)
    evaluator = Evaluator(along, budget=BUDGET)
    start = np.r_[0.0, along.others.restrict(theta)]
    radius = ParameterQuantity(parameters=along.parameters, name=RADIUS)
    walk = ProfileContext(evaluator, radius, threshold, evaluator(start))
    walk.is_final = is_last
    try:
        leg = march(walk, walk.point(walk.solve(0.0, start, tolerance=np.inf)), 1)
    except BetterOptimumFound as found:
        better = along.expand(found.theta)
        return {
            "better": better,
            "deviance": evaluator(found.theta).deviance,
            "n_simulations": evaluator.n_simulations,
        }
    points = sorted(leg.points, key=lambda x: x.value)
    return {
        "better": None,
        "direction": direction,
        "distances": [x.value for x in points],
        "deltas": [max(walk.delta(x), 0.0) for x in points],
        "slopes": [x.slope for x in points],
        "status": leg.side.status,
        "end": leg.side.reached if leg.side.end is None else leg.side.end,
        "n_simulations": evaluator.n_simulations,
    }


def _as_ray(row: dict[str, Any], optimum: Array) -> PairRay:
    direction = np.array(row["direction"])
    distances = np.array(row["distances"])
    return PairRay(
        values=optimum + distances[:, None] * direction,
        deltas=row["deltas"],
        slopes=row["slopes"],
        distances=distances,
        status=SideStatus(row["status"]),
        end=optimum + row["end"] * direction,
    )
