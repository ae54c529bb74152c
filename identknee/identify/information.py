"""The Fisher information at a point, geodesics along its sloppiest direction, structural rank."""

from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import Literal

import numpy as np
import scipy

from identknee.calibrate.problem import (
    RANK_TOLERANCE,
    Evaluation,
    Evaluator,
    Problem,
    SearchEnded,
    evaluate,
    floors,
    typical_steps,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import (
    OF_PARAMETER,
    Array,
    BoolArray,
    IntArray,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.executors import Executor, serial
from identknee.runs.progress import progress
from identknee.runs.record import WithSentence

# In scaled units. The perturbation must be small against any curvature and large against the
# rounding of theta; the steps are tried from long to short.
PERTURBATION = 1e-8
N_PERTURBATIONS = 8
STEPS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


@declared
class JacobianNoise:
    """Errors of the derivatives of m residuals by n scaled parameters."""

    rounding: float = entry(
        "Largest singular value of the change of the Jacobian under perturbations of theta of "
        "1e-8, linear change taken out: what the solver's tolerance and rounding do",
        unit="1",
    )
    errors: Array = array(
        "Differences of the residuals less the Jacobian, by the step that agrees best: bounds what "
        "is wrong with the Jacobian for any reason; zero in columns in which no step had a "
        "prediction",
        *("residual", "parameter"),
    )
    steps: Array = array(
        "Step of each column, in scaled units; NaN where none had a prediction", "parameter"
    )

    def floors(self, directions: Array) -> Array:
        """Square of the error along each of the unit `directions`, columns (n, k); ``(k,)``.

        An eigenvalue of the information below its floor may as well be zero.
        """
        along = np.linalg.norm(self.errors @ directions, axis=0)
        return np.asarray(np.maximum(along, self.rounding) ** 2)


def jacobian_noise(
    evaluator: Evaluator, at: Evaluation, scales: Array, *, seed: int = 0
) -> JacobianNoise:
    """The errors of the Jacobian at a point.

    Raises
    ------
    ValueError
        If the point lies outside the bounds.
    """
    parameters = evaluator.parameters
    outside = np.flatnonzero((at.theta < parameters.lower) | (at.theta > parameters.upper))
    if outside.size:
        i = int(outside[0])
        raise ValueError(
            f"{parameters.names[i]} is {at.theta[i]:g}, outside its bounds "
            f"{parameters.lower[i]:g} to {parameters.upper[i]:g}; give a theta inside them"
        )
    columns = [_column(evaluator, at, scales, i) for i in range(at.theta.size)]
    # Largest singular value of the noise of the Jacobian, over the perturbations.
    generator = np.random.default_rng(seed)
    sizes = [0.0]
    p = evaluator.parameters
    for _ in range(N_PERTURBATIONS):
        move = PERTURBATION * scales * generator.choice([-1.0, 1.0], at.theta.size)
        # Where a bound is in the way the middle of the three points moves inward.
        middle = np.clip(at.theta, p.lower + abs(move), p.upper - abs(move))
        three = [evaluator(middle + sign * move) for sign in (-1.0, 0.0, 1.0)]
        if all(x.is_finite for x in three):
            low, here, high = (x.jacobian * scales for x in three)
            # The variance of independent errors in such a sum is 1 + 4 + 1 times theirs.
            noise = (low - 2.0 * here + high) / np.sqrt(6.0)
            sizes.append(float(np.linalg.norm(noise, 2)))
    return JacobianNoise(
        rounding=max(sizes),
        errors=np.stack([error for error, _ in columns], axis=1),
        steps=np.array([step for _, step in columns]),
    )


def _column(evaluator: Evaluator, at: Evaluation, scales: Array, i: int) -> tuple[Array, float]:
    """Difference less derivative by one parameter, and the step where they agree best."""
    exact = at.jacobian[:, i] * scales[i]
    best, best_step = np.zeros(exact.size), np.nan
    for step in STEPS:
        slope = _difference(evaluator, at, i, step * scales[i])
        if slope is None:
            continue
        error = slope * scales[i] - exact
        if np.isnan(best_step) or np.linalg.norm(error) < np.linalg.norm(best):
            best, best_step = error, step
    return best, best_step


def _difference(evaluator: Evaluator, at: Evaluation, i: int, step: float) -> Array | None:
    """Fourth-order central difference; second-order to the inside where a bound is near."""
    parameters, place = evaluator.parameters, at.theta[i]
    room_below, room_above = place - parameters.lower[i], parameters.upper[i] - place

    def residuals(steps: float) -> Array:
        theta = np.array(at.theta)
        theta[i] += steps * step
        found = evaluator(theta)
        return found.residuals if found.is_finite else np.full(at.residuals.size, np.nan)

    if min(room_below, room_above) >= 2.0 * step:
        near, far = residuals(1.0) - residuals(-1.0), residuals(2.0) - residuals(-2.0)
        slope = (8.0 * near - far) / (12.0 * step)
    elif max(room_below, room_above) >= 2.0 * step:
        side = 1.0 if room_above > room_below else -1.0
        there = 4.0 * residuals(side) - residuals(2.0 * side)
        slope = (there - 3.0 * at.residuals) / (2.0 * side * step)
    else:
        return None
    return slope if np.isfinite(slope).all() else None


Scaling = Literal["typical", "prior"]
# Pairs and triples that are listed.
MOST_COLLINEAR = 3
# A share of a parameter in a direction that is not worth naming.
NEGLIGIBLE_SHARE = 0.1
# A share below this, squared, is rounding: the parameter has no part in an undetermined direction.
ROUNDING = 1e-12


@declared
class Eigenvalue:
    """How well the data determine one combination of parameters."""

    value: float = entry("Eigenvalue of the information in scaled units", unit="1")
    floor: float = entry("Value below which it is the solver's noise", unit="1")
    above_noise: bool = entry("Whether it is larger than that")
    combination: str = entry("Shares of the parameters in the combination, the largest first")


@declared
class Collinear:
    """Parameters whose effects are nearly collinear."""

    parameters: tuple[str, ...] = entry("Names of the parameters")
    collinearity: float = entry("Collinearity index of the set", unit="1")


@declared
class Information:
    """The Fisher information of n parameters at one theta, in scaled units.

    A scaled unit of a parameter is its entry in `scales`: moving one unit along eigenvector i
    raises the deviance by ``eigenvalues[i]`` (to second order), so that the data know the
    combination to ``1 / sqrt(eigenvalues[i])`` units.
    """

    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    scaling: Scaling = entry(
        "Scaled unit: typical for a typical step (3 kN, 2 %, a prior's sd for other units), prior "
        "for the prior's standard deviation, in which an eigenvalue of 1 means that the data say "
        "as much as the prior"
    )
    theta: Array = array("Parameters at which it was computed", "parameter", unit=OF_PARAMETER)
    scales: Array = array(
        "One scaled unit of each parameter", "parameter", unit=OF_PARAMETER, key="scale"
    )
    jacobian: Array = array(
        "Derivatives of the residuals, in units of their noise, by the scaled parameters",
        *("residual", "parameter"),
    )
    eigenvalues: Array = array(
        "Eigenvalues in scaled units, from stiff to sloppy", "direction", key="eigenvalue"
    )
    eigenvectors: Array = array(
        "Eigenvectors as columns in the same order, the largest component of each positive",
        *("parameter", "direction"),
        key="eigenvector",
    )
    floors: Array = array(
        "Eigenvalue that the error of the derivatives alone would give in each direction",
        "direction",
        key="floor",
    )
    noise: JacobianNoise = entry("Errors of the derivatives")
    n_simulations: int = entry(
        "Simulations made, most of them for the noise",
        unit="1",
        is_in_json=False,
        is_in_arrays=True,
    )

    @property
    def matrix(self) -> Array:
        """The information in kN, % and the other units of theta, shape ``(n, n)``."""
        plain = self.jacobian / self.scales
        return np.asarray(plain.T @ plain)

    @property
    @derived(
        "Eigenvalues from stiff to sloppy, and the combinations they belong to", key="eigenvalues"
    )
    def spectrum(self) -> tuple[Eigenvalue, ...]:
        return tuple(
            Eigenvalue(
                value=float(value),
                floor=float(floor),
                above_noise=bool(value > floor),
                combination=self.combination(i),
            )
            for i, (value, floor) in enumerate(zip(self.eigenvalues, self.floors, strict=True))
        )

    @property
    @derived("Number of eigenvalues above the noise", unit="1")
    def n_above_noise(self) -> int:
        """Number of eigenvalues above the errors of the derivatives."""
        return int(np.sum(self.eigenvalues > self.floors))

    @property
    @derived("Largest over smallest eigenvalue; null if the smallest is not above noise", unit="1")
    def condition(self) -> float:
        """Largest over smallest eigenvalue; infinite if the smallest is not above the noise."""
        if self.n_above_noise < len(self.eigenvalues):
            return np.inf
        return float(self.eigenvalues[0] / self.eigenvalues[-1])

    @property
    def sd(self) -> Array:
        """Standard deviation of each parameter by the linear model, in its own unit, ``(n,)``.

        Infinite where the parameter has a part in a direction that is not above the noise.
        """
        known, loose = self._spread()
        return np.where(np.diag(loose) > ROUNDING, np.inf, self.scales * np.sqrt(np.diag(known)))

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters by the linear model, shape ``(n, n)``.

        Where standard deviations are infinite it is the limit of those of a direction that gets
        ever less determined.
        """
        known, loose = self._spread()
        is_loose = np.diag(loose) > ROUNDING
        one_loose = is_loose[:, None] != is_loose
        covariance = np.where(is_loose[:, None] & is_loose, loose, np.where(one_loose, 0.0, known))
        sd = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(sd, sd))

    def combination(self, i: int) -> str:
        """Eigenvector i by the names of the parameters, in scaled units, largest share first.

        For example ``"+0.80 PCL.stiffness_kN -0.57 PCL.reference_strain_pct"``; shares below 0.1
        are left out.
        """
        return combination(self.parameter_names, self.eigenvectors[:, i])

    def collinearity(self, names: Sequence[str] | None = None) -> float:
        """Collinearity index of the parameters named.

        One over the least length of a unit combination of their columns, each of length 1: 1 for
        columns at right angles, infinite for dependent ones. From 10 to 15 on, changes of one
        parameter can be made up for by the others to within 10 to 7 % (all parameters if None).

        References
        ----------
        R. Brun, P. Reichert and H. R. Kuensch, Practical identifiability analysis of large
        environmental simulation models, Water Resour. Res. 37 (2001) 1015-1030, equation 10,
        doi:10.1029/2000WR900350.
        """
        chosen = [self.parameter_names.index(x) for x in names or self.parameter_names]
        return _collinearity(self.jacobian[:, chosen])

    def collinear_sets(self, size: int) -> tuple[Collinear, ...]:
        """All sets of `size` parameters with their collinearity, from large to small.

        Raises
        ------
        ValueError
            If the size is not between 2 and the number of parameters.
        """
        n = len(self.parameter_names)
        if not 2 <= size <= n:
            raise ValueError(f"a set must hold 2 to {n} parameters, got {size}")
        sets = [
            Collinear(
                parameters=tuple(self.parameter_names[i] for i in chosen),
                collinearity=_collinearity(self.jacobian[:, chosen]),
            )
            for chosen in map(list, combinations(range(n), size))
        ]
        return tuple(sorted(sets, key=lambda x: -x.collinearity))

    @property
    @derived("Collinearity index of all parameters", unit="1", key="collinearity")
    def collinearity_of_all(self) -> float:
        return self.collinearity()

    @property
    @derived("Pairs and triples that stand in for one another best", key="collinear")
    def most_collinear(self) -> tuple[Collinear, ...]:
        sizes = [x for x in (2, 3) if x <= len(self.parameter_names)]
        return tuple(x for size in sizes for x in self.collinear_sets(size)[:MOST_COLLINEAR])

    @property
    @derived("Parameters at which it was computed, by name", unit=OF_PARAMETER, key="theta")
    def theta_by_name(self) -> dict[str, float]:
        return dict(zip(self.parameter_names, self.theta.tolist(), strict=True))

    @property
    @derived("Scaled unit of each parameter", unit=OF_PARAMETER, key="scales")
    def scale_by_name(self) -> dict[str, float]:
        return dict(zip(self.parameter_names, self.scales.tolist(), strict=True))

    @property
    @derived(
        "Standard deviation of each parameter if the model were linear; null where the data do "
        "not determine it",
        unit=OF_PARAMETER,
        key="sd",
    )
    def sd_by_name(self) -> dict[str, float]:
        return dict(zip(self.parameter_names, self.sd.tolist(), strict=True))

    def _spread(self) -> tuple[Array, Array]:
        """Scaled covariance within the directions above the noise, projector on the others."""
        is_known = self.eigenvalues > self.floors
        known, loose = self.eigenvectors[:, is_known], self.eigenvectors[:, ~is_known]
        return known / self.eigenvalues[is_known] @ known.T, loose @ loose.T


def information(
    problem: Problem, theta: Array, *, scaling: Scaling = "typical", seed: int = 0
) -> Information:
    """The Fisher information of the parameters at `theta`, with the errors of the derivatives.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise. `WithPriors` of it gives the
        information of data and priors together.
    theta
        Where, within the bounds, shape ``(n,)``; usually the best fit.
    scaling
        What to count parameters in, which eigenvalues and eigenvectors depend on: ``"typical"``
        steps or ``"prior"`` standard deviations.
    seed
        Seed of the perturbations that show the solver's noise.

    Raises
    ------
    ValueError
        If the model has no prediction at `theta`, or `theta` lies outside the bounds.

    References
    ----------
    J. J. Waterfall et al., Sloppy-model universality class and the Vandermonde matrix, Phys. Rev.
    Lett. 97 (2006) 150601, doi:10.1103/PhysRevLett.97.150601.
    """
    parameters, evaluator = problem.parameters, Evaluator(problem)
    scales = scaled_units(parameters, scaling)
    evaluation = evaluator(np.asarray(theta, dtype=np.float64))
    if not evaluation.is_finite:
        raise ValueError(
            "the model has no prediction at this theta, so nothing is known of its derivatives; "
            "give another theta, for example the best fit"
        )
    noise = jacobian_noise(evaluator, evaluation, scales, seed=seed)
    jacobian = evaluation.jacobian * scales
    eigenvalues, eigenvectors = spectrum(jacobian)
    # What rounding alone does to the singular values.
    rounding = max(jacobian.shape) * np.finfo(np.float64).eps * np.linalg.norm(jacobian, 2)
    return Information(
        parameter_names=parameters.names,
        theta=evaluation.theta,
        scaling=scaling,
        scales=scales,
        jacobian=jacobian,
        eigenvalues=eigenvalues,
        eigenvectors=eigenvectors,
        floors=np.maximum(noise.floors(eigenvectors), rounding**2),
        noise=noise,
        n_simulations=evaluator.n_simulations,
    )


def scaled_units(parameters: Parameters, scaling: Scaling) -> Array:
    """One scaled unit of each parameter, shape ``(n,)``.

    Raises
    ------
    ValueError
        If there is no such scaling.
    """
    if scaling == "typical":
        return typical_steps(parameters)
    if scaling == "prior":
        return parameters.prior_sd_in_own_units
    raise ValueError(f"there is no scaling {scaling!r}; the scalings are typical, prior")


def spectrum(jacobian: Array) -> tuple[Array, Array]:
    """Eigenvalues of ``jacobian.T @ jacobian`` from large to small, eigenvectors as columns.

    From the singular values, so that small eigenvalues keep their digits; the largest component of
    an eigenvector is positive.

    Examples
    --------
    >>> spectrum(np.diag([1.0, 3.0]))[0].tolist()
    [9.0, 1.0]
    """
    n = jacobian.shape[1]
    _, sizes, rows = np.linalg.svd(np.vstack([jacobian, np.zeros((n, n))]), full_matrices=False)
    vectors = rows.T
    largest = vectors[np.argmax(np.abs(vectors), axis=0), np.arange(n)]
    return sizes**2, vectors * np.sign(largest)


def shares(names: Sequence[str], direction: Array) -> list[tuple[str, float]]:
    """Parameters of a direction of length 1 in scaled units, and their shares of at least 0.1.

    The largest comes first.
    """
    order = np.argsort(-np.abs(direction), kind="stable")
    return [(names[i], float(direction[i])) for i in order if abs(direction[i]) >= NEGLIGIBLE_SHARE]


def combination(names: Sequence[str], direction: Array) -> str:
    """A direction of length 1 in scaled units by the names of the parameters."""
    return " ".join(f"{share:+.2f} {name}" for name, share in shares(names, direction))


def _collinearity(columns: Array) -> float:
    lengths = np.linalg.norm(columns, axis=0)
    if not lengths.all():
        return np.inf
    least = np.linalg.svd(columns / lengths, compute_uv=False)[-1]
    if len(columns) < columns.shape[1] or least <= np.finfo(np.float64).eps:
        return np.inf
    return float(1.0 / least)


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


class Boundary(WithSentence):
    """What ends a geodesic."""

    NO_INFLUENCE = (
        "no_influence",
        "These no longer affect any prediction, as where a ligament is slack.",
    )
    ZERO = ("zero", "Here zero is reached, the least value.")
    BOUND = ("bound", "Here a bound of the range is reached.")
    STANDSTILL = ("standstill", "The predictions stop changing along a combination of these.")
    INFINITY = ("infinity", "These diverge, and the predictions keep changing.")
    CLIFF = ("cliff", "Beyond this point the model has no prediction.")
    BUDGET = ("budget", "The budget of simulations was exhausted on the way.")


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
        last = combination(self.parameter_names, self.directions[-1])
        return f"{self.boundary.sentence} ({', '.join(self.involved)}; going along {last})"

    @property
    @derived("Parameters where it ends, by name", unit=OF_PARAMETER)
    def end(self) -> dict[str, float]:
        return dict(zip(self.parameter_names, self.thetas[-1].tolist(), strict=True))

    @property
    @derived("Length on the surface of predictions, in units of the noise", unit="1")
    def length(self) -> float:
        return float(self.lengths[-1])

    @property
    @derived("Deviance at the end less that at the start", unit="1")
    def rise_of_deviance(self) -> float:
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
                    return end, _unit(along + length * self._geodesic_acceleration(half, aside))
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


N_POINTS = 64
NO_RANK = -1
# Derivatives by a scaled unit below this part of the noise are those of no influence.
NO_SLOPE = 1e-12


class Structure(WithSentence):
    """The verdict on structural identifiability."""

    FULL_RANK = ("full_rank", "All parameters are structurally identifiable (locally).")
    RANK_DEFICIENT = (
        "rank_deficient",
        "Even noise-free data would leave a combination of parameters undetermined.",
    )
    UNKNOWN = ("unknown", "The model has no prediction at any of the random points.")


@declared
class StructureCheck:
    """Ranks of the sensitivities at random points of the box."""

    seed: int = entry("Seed of the points", unit="1")
    undetermined: tuple[str, ...] = entry(
        "Parameters that have a part in the undetermined directions of the points of largest rank; "
        "none if that rank is full"
    )
    thetas: Array = array("Points", "point", "parameter", unit=OF_PARAMETER, key="theta")
    ranks: IntArray = array(
        "Rank of the Jacobian at each point; -1 where the model has no prediction",
        "point",
        dtype=int,
        key="rank",
    )
    singular_values: Array = array(
        "Singular values of the Jacobian with columns of length 1, from large to small; NaN where "
        "the model has no prediction",
        *("point", "direction"),
        key="singular_value",
    )
    has_no_influence: BoolArray = array(
        "Whether a parameter changes no residual there at all, as those of a slack ligament",
        *("point", "parameter"),
        dtype=bool,
    )

    @property
    def has_prediction(self) -> BoolArray:
        """Whether the model has a prediction at each point, shape ``(k,)``."""
        return np.asarray(self.ranks != NO_RANK)

    @property
    @derived("Points drawn", unit="1")
    def n_points(self) -> int:
        return len(self.ranks)

    @property
    @derived("Points with a prediction", unit="1")
    def n_with_prediction(self) -> int:
        return int(self.has_prediction.sum())

    @property
    @derived("Largest rank met; -1 where there is no prediction at any point", unit="1")
    def rank(self) -> int:
        """The largest rank met, that of almost all points where derivatives are analytic."""
        return int(self.ranks.max())

    @property
    @derived("Whether data without noise would determine every parameter")
    def verdict(self) -> Structure:
        if self.rank == NO_RANK:
            return Structure.UNKNOWN
        is_full = self.rank == self.thetas.shape[1]
        return Structure.FULL_RANK if is_full else Structure.RANK_DEFICIENT

    @property
    @derived("What the verdict means")
    def sentence(self) -> str:
        return self.verdict.sentence


def check_structure(
    problem: Problem,
    *,
    n_points: int = N_POINTS,
    seed: int = 0,
    executor: Executor = serial,
) -> StructureCheck:
    """The rank of the sensitivities at random points of the box.

    A parameter that is structurally undetermined is so at every point; one that a slack ligament
    leaves without influence is so at some.

    Parameters
    ----------
    problem
        With exact derivatives; those by differences hide a deficient rank in their errors.
    n_points
        How many scrambled Sobol points to try; those without a prediction are kept as data.
    seed
        Seed of their scrambling.
    executor
        Anything with an ordered ``map``.

    Raises
    ------
    ValueError
        If fewer than one point is asked for, or a bound is not finite.

    References
    ----------
    J. A. Jacquez and P. Greif, Numerical parameter identifiability and estimability, Math. Biosci.
    77 (1985) 201-227, doi:10.1016/0025-5564(85)90098-7.
    """
    parameters = problem.parameters
    if n_points < 1:
        raise ValueError(f"the number of points must be at least 1, got {n_points}")
    bounds = np.stack([parameters.lower, parameters.upper])
    if not np.isfinite(bounds).all():
        i = int(np.flatnonzero(~np.isfinite(bounds).all(axis=0))[0])
        raise ValueError(
            f"{parameters.names[i]} has no finite bounds to draw points from; set them with "
            "with_bounds"
        )
    # Sobol points are balanced in powers of two only; the rest of such a set is left out.
    drawn = scipy.stats.qmc.Sobol(parameters.n, seed=seed).random_base2(
        int(np.ceil(np.log2(n_points)))
    )
    thetas = np.asarray(bounds[0] + (bounds[1] - bounds[0]) * drawn[:n_points])
    found = executor.map(partial(_point_rank, problem), thetas)
    rows = list(progress(found, total=len(thetas), description="ranks"))
    ranks = np.array([rank for rank, _, _, _ in rows])
    best = [row for row in rows if row[0] == ranks.max() != NO_RANK]
    loose = np.any([row[3] for row in best], axis=0) if best else np.zeros(parameters.n, bool)
    return StructureCheck(
        seed=seed,
        thetas=thetas,
        ranks=ranks,
        singular_values=np.array([sizes for _, sizes, _, _ in rows]),
        has_no_influence=np.array([dead for _, _, dead, _ in rows]),
        undetermined=tuple(np.array(parameters.names)[loose].tolist()),
    )


def _point_rank(problem: Problem, theta: Array) -> tuple[int, Array, BoolArray, BoolArray]:
    """Rank, singular values, parameters without influence, those in undetermined directions."""
    n, at = problem.parameters.n, evaluate(problem, theta)
    if not at.is_finite:
        return NO_RANK, np.full(n, np.nan), np.zeros(n, bool), np.zeros(n, bool)
    jacobian = at.jacobian * scaled_units(problem.parameters, "typical")
    lengths = np.linalg.norm(jacobian, axis=0)
    dead = lengths < NO_SLOPE
    columns = np.where(dead, 0.0, jacobian / np.where(dead, 1.0, lengths))
    padded = np.vstack([columns, np.zeros((n, n))])
    _, sizes, rows = np.linalg.svd(padded, full_matrices=False)
    is_known = sizes > RANK_TOLERANCE * max(float(sizes[0]), 1.0)
    loose = (np.abs(rows[~is_known]) > np.sqrt(RANK_TOLERANCE)).any(axis=0)
    return int(is_known.sum()), sizes, dead, loose
