"""Geodesics of the model manifold along the sloppiest direction, to its boundary."""

from enum import Enum

import numpy as np

from identknee.calibrate.evaluation import Evaluation, Evaluator, SearchEnded
from identknee.calibrate.problem import Problem, floors
from identknee.identify.information import Scaling, combination, scaled_units, spectrum
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry

BUDGET = 3000
# In scaled units of the parameters.
LONGEST_STEP, SHORTEST_STEP = 0.25, 1e-3
LONGEST_PATH = 100.0
DIFFERENCE_STEP = 0.02
# Of the direction in one step [rad].
MOST_TURN = 0.1
# Singular values below this part of the largest one do not drive the acceleration.
DAMPING = 1e-6
# Parts of what they were at the start, below which an influence counts as lost.
NO_INFLUENCE, NO_SPEED = 1e-3, 1e-3


class Boundary(Enum):
    """What ends a geodesic."""

    NO_INFLUENCE = "no_influence"
    ZERO = "zero"
    BOUND = "bound"
    STANDSTILL = "standstill"
    INFINITY = "infinity"
    CLIFF = "cliff"
    BUDGET = "budget"

    @property
    def sentence(self) -> str:
        """The same as a full sentence, to which the parameters involved are added."""
        return _SENTENCES[self]


_SENTENCES = {
    Boundary.NO_INFLUENCE: "These no longer affect any prediction, as where a ligament is slack.",
    Boundary.ZERO: "Here zero is reached, the least value.",
    Boundary.BOUND: "Here a bound of the range is reached.",
    Boundary.STANDSTILL: "The predictions stop changing along a combination of these.",
    Boundary.INFINITY: "These diverge, and the predictions keep changing.",
    Boundary.CLIFF: "Beyond this point the model has no prediction.",
    Boundary.BUDGET: "The budget of simulations was exhausted on the way.",
}


@declared
class Geodesic:
    """A geodesic of the model manifold, from a point along a direction."""

    boundary: Boundary = entry("What ended it")
    involved: tuple[str, ...] = entry("Parameters that its sentence is about")
    parameter_names: tuple[str, ...] = entry("Names of the parameters, in the order of theta")
    scales: Array = array(
        "One scaled unit of each parameter", "parameter", unit=OF_PARAMETER, key="scale"
    )
    thetas: Array = array(
        "Points of the path, the first where it starts",
        *("point", "parameter"),
        unit=OF_PARAMETER,
        key="theta",
    )
    directions: Array = array(
        "Unit directions there in scaled units", "point", "parameter", key="direction"
    )
    speeds: Array = array(
        "Change of the residuals for each scaled unit of the path", "point", key="speed"
    )
    deviances: Array = array("Deviance at each point", "point", key="deviance")
    n_simulations: int = entry("Simulations made", unit="1")

    @property
    def lengths(self) -> Array:
        """Arc length from the start to each point, in units of the noise, ``(k,)``."""
        steps = np.linalg.norm(np.diff(self.thetas / self.scales, axis=0), axis=1)
        return np.concatenate(
            [[0.0], np.cumsum(steps * 0.5 * (self.speeds[1:] + self.speeds[:-1]))]
        )

    @property
    @derived("Where it goes and what ended it")
    def sentence(self) -> str:
        """Where it goes and what ended it."""
        last = combination(self.parameter_names, self.directions[-1])
        return f"{self.boundary.sentence} ({', '.join(self.involved)}; going along {last})"

    @property
    @derived("Parameters where it ends, by name", unit=OF_PARAMETER)
    def end(self) -> dict[str, float]:
        """The last point by parameter."""
        return dict(zip(self.parameter_names, self.thetas[-1].tolist(), strict=True))

    @property
    @derived("Length on the surface of predictions, in units of the noise", unit="1")
    def length(self) -> float:
        """Arc length from the start to the end, in units of the noise."""
        return float(self.lengths[-1])

    @property
    @derived("Deviance at the end less that at the start", unit="1")
    def rise_of_deviance(self) -> float:
        """How much worse the end fits than the start."""
        return float(self.deviances[-1] - self.deviances[0])


def geodesics(
    problem: Problem,
    theta: Array,
    *,
    scaling: Scaling = "typical",
    budget: int = BUDGET,
) -> tuple[Geodesic, Geodesic]:
    """The two geodesics along the sloppiest direction at `theta`, to boundaries that are named.

    The first starts along the eigenvector of the smallest eigenvalue of the information (its
    largest component positive), the second against it. Each goes on until it meets a boundary of
    the model or of the box. The path is measured in scaled units of the parameters, in which it
    moves at unit speed however little the predictions change.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    theta
        Where to start, within the bounds, shape ``(n,)``; usually the best fit.
    scaling
        Units of the parameters, as in `information`.
    budget
        Simulations allowed for each.

    Raises
    ------
    ValueError
        If the model has no prediction at `theta`.

    References
    ----------
    M. K. Transtrum, B. B. Machta and J. P. Sethna, Geometry of nonlinear least squares with
    applications to sloppy models and optimization, Phys. Rev. E 83 (2011) 036701, equation 20,
    doi:10.1103/PhysRevE.83.036701.
    """
    start = np.asarray(theta, dtype=np.float64)
    scales = scaled_units(problem.parameters, scaling)
    at = Evaluator(problem)(start)
    if not at.is_finite:
        raise ValueError("the model has no prediction at this theta; start at the best fit")
    sloppiest = spectrum(at.jacobian * scales)[1][:, -1]
    first, second = (
        _Walk(problem, scales, budget).run(at, sign * sloppiest) for sign in (1.0, -1.0)
    )
    return first, second


class _Walk:
    """The integration of one geodesic."""

    def __init__(self, problem: Problem, scales: Array, budget: int) -> None:
        self._evaluator = Evaluator(problem, budget=budget)
        self._parameters = problem.parameters
        self._scales = scales
        self._points: list[tuple[Array, Array, float, float]] = []
        self._influence = np.zeros(scales.size)

    def run(self, start: Evaluation, direction: Array) -> Geodesic:
        """The geodesic from `start` along a unit direction in scaled units."""
        self._influence = np.linalg.norm(start.jacobian * self._scales, axis=0)
        at, along = start, direction
        self._keep(at, along)
        try:
            ended = self._end(at, along)
            while ended is None:
                moved = self._step(at, along)
                if moved is None:
                    ended = (Boundary.CLIFF, self._most(along))
                    break
                at, along = moved
                self._keep(at, along)
                ended = self._end(at, along)
        except SearchEnded:
            ended = (Boundary.BUDGET, self._most(along))
        thetas, directions, speeds, deviances = map(np.array, zip(*self._points, strict=True))
        return Geodesic(
            parameter_names=self._parameters.names,
            scales=self._scales,
            thetas=thetas,
            directions=directions,
            speeds=speeds,
            deviances=deviances,
            boundary=ended[0],
            involved=ended[1],
            n_simulations=self._evaluator.n_simulations,
        )

    def _keep(self, at: Evaluation, along: Array) -> None:
        self._points.append((at.theta, along, self._speed(at, along), at.deviance))

    def _speed(self, at: Evaluation, along: Array) -> float:
        return float(np.linalg.norm(at.jacobian @ (self._scales * along)))

    def _step(self, at: Evaluation, along: Array) -> tuple[Evaluation, Array] | None:
        """The next point and direction by the midpoint rule; None before a cliff."""
        length = LONGEST_STEP
        bending = self._geodesic_acceleration(at, along)
        length = min(length, MOST_TURN / max(float(np.linalg.norm(bending)), 1e-12))
        length = max(length, SHORTEST_STEP)
        while length >= SHORTEST_STEP:
            half = self._moved(at, along, 0.5 * length)
            if half.is_finite:
                aside = _unit(along + 0.5 * length * bending)
                end = self._moved(at, aside, length)
                if end.is_finite:
                    turned = along + length * self._geodesic_acceleration(half, aside)
                    return end, _unit(turned)
            length *= 0.5
        return None

    def _moved(self, at: Evaluation, along: Array, length: float) -> Evaluation:
        """The point `length` further, or where the way leaves the box."""
        move = self._scales * along
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(
                move > 0, self._parameters.upper - at.theta, self._parameters.lower - at.theta
            )
            room = np.where(move == 0.0, np.inf, room / move)
        length = min(length, float(room.min()))
        theta = at.theta + length * move
        # What arrives at its bound is put there, whatever rounding made of it.
        arrived = room <= length
        bound = np.where(move > 0, self._parameters.upper, self._parameters.lower)
        theta[arrived] = bound[arrived]
        return self._evaluator(np.clip(theta, self._parameters.lower, self._parameters.upper))

    def _geodesic_acceleration(self, at: Evaluation, along: Array) -> Array:
        """Geodesic acceleration: derivative of the unit direction by arc length, ``(n,)``.

        The second derivative of the residuals along the way, taken off by the parameters as far
        as they can (equation 20 of the reference of `geodesics`), less its part along the way.
        """
        ends = [self._moved(at, sign * along, DIFFERENCE_STEP) for sign in (-1.0, 1.0)]
        low, high = (end if end.is_finite else at for end in ends)
        apart = float(np.linalg.norm((high.theta - low.theta) / self._scales))
        if apart == 0.0:
            return np.zeros(along.size)
        second = (high.jacobian - low.jacobian) @ (self._scales * along) / apart
        left, size, right = np.linalg.svd(at.jacobian * self._scales, full_matrices=False)
        damped = size / (size**2 + (DAMPING * size[0]) ** 2) if size[0] > 0 else size
        bending = -right.T @ (damped * (left.T @ second))
        return np.asarray(bending - along * (along @ bending))

    def _end(self, at: Evaluation, along: Array) -> tuple[Boundary, tuple[str, ...]] | None:
        """The boundary reached by the path, with the parameters involved."""
        low, high = at.theta <= self._parameters.lower, at.theta >= self._parameters.upper
        out = (low & (along < 0)) | (high & (along > 0))
        if out.any():
            is_zero = low & (at.theta == floors(self._parameters))
            kind = Boundary.ZERO if (is_zero & out).any() else Boundary.BOUND
            return kind, self._names(out & is_zero if kind is Boundary.ZERO else out)
        influence = np.linalg.norm(at.jacobian * self._scales, axis=0)
        lost = (influence < NO_INFLUENCE * self._influence) & (self._influence > 0)
        if lost.any():
            return Boundary.NO_INFLUENCE, self._names(lost)
        if self._speed(at, along) < NO_SPEED * self._points[0][2]:
            return Boundary.STANDSTILL, self._most(along)
        way = np.linalg.norm((at.theta - self._points[0][0]) / self._scales)
        if way > LONGEST_PATH:
            return Boundary.INFINITY, self._most(along)
        return None

    def _names(self, chosen: BoolArray) -> tuple[str, ...]:
        return tuple(np.array(self._parameters.names)[chosen].tolist())

    def _most(self, along: Array) -> tuple[str, ...]:
        """The parameters with at least half the share of the dominant one."""
        return self._names(np.asarray(np.abs(along) >= 0.5 * np.abs(along).max()))


def _unit(direction: Array) -> Array:
    return np.asarray(direction / np.linalg.norm(direction))
