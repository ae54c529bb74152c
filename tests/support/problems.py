"""Closed-form calibration problems whose minimum is known, to be crossed with every optimizer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identknee.model.parameters import Parameters, ligament_parameters
from identknee.runs.declare import Array

LIGAMENTS = ("ACL", "PCL", "LCL", "MCL")
# Table 1 of the paper: kN, then %.
REFERENCE = np.array([10.0, 18.0, 6.0, 8.3, 8.0, -4.0, 2.0, 4.0])
IG2 = np.array([9.5, 17.5, 6.5, 8.0, 7.5, -3.5, 2.5, 4.5])
IG4 = np.array([8.0] * 4 + [4.0] * 4)
TOE_STRAIN = 0.03


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedForm:
    """A problem in a few lines of arithmetic, with its start and its known minimum."""

    name: str
    parameters: Parameters
    start: Array
    minimum: Array
    lowest: float
    residuals_at: Callable[[Array], Array]
    jacobian_at: Callable[[Array], Array]

    def residuals(self, theta: Array) -> Array:
        return self.residuals_at(theta)

    def jacobian(self, theta: Array) -> Array:
        return self.jacobian_at(theta)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cliff:
    """A problem without a prediction where `beyond` is positive."""

    problem: ClosedForm
    beyond: Callable[[Array], float]

    @property
    def parameters(self) -> Parameters:
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        residuals = self.problem.residuals(theta)
        return np.full_like(residuals, np.inf) if self.beyond(theta) > 0 else residuals

    def jacobian(self, theta: Array) -> Array:
        assert self.beyond(theta) <= 0, "no derivatives are to be asked beyond the cliff"
        return self.problem.jacobian(theta)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """Residuals ``matrix @ theta - data``: picklable, and its minimum is a formula."""

    parameters: Parameters
    matrix: Array
    data: Array

    def residuals(self, theta: Array) -> Array:
        return self.matrix @ theta - self.data

    def jacobian(self, theta: Array) -> Array:
        return self.matrix


def plain_parameters(n: int, low: float = -10.0, high: float = 10.0) -> Parameters:
    """Parameters in %, so that first candidates lie within 3 of the start."""
    return Parameters(
        names=tuple(f"x{i}.value_pct" for i in range(n)),
        center=np.zeros(n),
        lower=np.full(n, low),
        upper=np.full(n, high),
        prior_sd=np.full(n, 2.0),
        is_log=np.zeros(n, bool),
    )


def linear(n: int = 3, m: int = 8, seed: int = 1) -> ClosedForm:
    """Linear least squares with noise: the minimum solves the normal equations."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(m, n))
    data = matrix @ rng.uniform(-2, 2, n) + 0.3 * rng.normal(size=m)
    minimum = np.array(np.linalg.solve(matrix.T @ matrix, matrix.T @ data), dtype=np.float64)
    return ClosedForm(
        name="linear",
        parameters=plain_parameters(n),
        start=minimum + rng.uniform(-2, 2, n),
        minimum=minimum,
        lowest=0.5 * float(np.sum((matrix @ minimum - data) ** 2)),
        residuals_at=lambda theta: matrix @ theta - data,
        jacobian_at=lambda _: matrix,
    )


def rosenbrock() -> ClosedForm:
    """Rosenbrock's valley as two residuals, its minimum 0 at (1, 1)."""
    return ClosedForm(
        name="rosenbrock",
        parameters=plain_parameters(2),
        start=np.array([-1.2, 1.0]),
        minimum=np.ones(2),
        lowest=0.0,
        residuals_at=lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
        jacobian_at=lambda x: np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
    )


def active_bounds() -> ClosedForm:
    """A nonlinear problem whose minimum has one parameter at each of two bounds.

    With residuals ``x0 + 1, x1 - x0^2 - 1, x2 - 9`` and the box [0, 5]: x0 = 0, x1 = 1, x2 = 5.
    """
    return ClosedForm(
        name="active bounds",
        parameters=plain_parameters(3, 0.0, 5.0),
        start=np.array([2.0, 3.0, 3.0]),
        minimum=np.array([0.0, 1.0, 5.0]),
        lowest=0.5 * (1.0 + 16.0),
        residuals_at=lambda x: np.array([x[0] + 1, x[1] - x[0] ** 2 - 1, x[2] - 9]),
        jacobian_at=lambda x: np.array([[1.0, 0, 0], [-2 * x[0], 1, 0], [0, 0, 1]]),
    )


def sloppy_springs(noise: float = 0.0) -> ClosedForm:
    """Four toe-and-linear springs pulled by a known stretch each: eight parameters, as in a knee.

    A trial lengthens each line by a fixed part and measures five mixed sums of the forces. A
    stiffer, slacker line gives nearly the same forces as a softer, tauter one. The minimum is the
    reference unless there is noise; then it is not known in closed form.
    """
    rng = np.random.default_rng(5)
    stretch = rng.uniform(-0.06, 0.08, size=(20, 4))
    mixing = rng.normal(size=(20, 5, 4)) * 2.0

    def forces(theta: Array) -> tuple[Array, Array, Array]:
        strain = (1 + stretch) * (1 + theta[4:] / 100) - 1
        shape = np.where(strain > 2 * TOE_STRAIN, strain - TOE_STRAIN, strain**2 / (4 * TOE_STRAIN))
        slope = np.where(strain > 2 * TOE_STRAIN, 1.0, strain / (2 * TOE_STRAIN))
        taut = strain > 0
        by_strain = theta[:4] * slope * taut * (1 + stretch) / 100
        return theta[:4] * shape * taut, shape * taut, by_strain

    def mixed(per_line: Array) -> Array:
        return np.asarray(np.einsum("toi,ti->to", mixing, per_line).ravel())

    def jacobian(theta: Array) -> Array:
        _, by_stiffness, by_strain = forces(theta)
        columns = [np.einsum("toi,ti->toi", mixing, d) for d in (by_stiffness, by_strain)]
        return np.concatenate(columns, axis=2).reshape(-1, 8)

    data = mixed(forces(REFERENCE)[0]) + noise * rng.normal(size=100)
    return ClosedForm(
        name="sloppy springs",
        parameters=ligament_parameters(LIGAMENTS, REFERENCE[:4].tolist(), REFERENCE[4:].tolist()),
        start=np.array(IG2),
        minimum=np.array(REFERENCE),
        lowest=0.0,
        residuals_at=lambda theta: mixed(forces(theta)[0]) - data,
        jacobian_at=jacobian,
    )


def disc_in_the_way() -> Cliff:
    """A plane with its minimum at (4, 0.5) and a start at (-4, -0.3), a disc of radius 2 between.

    The straight descent ends on the disc; a way around it goes down all along.
    """
    target = np.array([4.0, 0.5])
    turned = np.array([[3.0, 1.0], [-1.0, 2.0]])
    problem = ClosedForm(
        name="disc in the way",
        parameters=plain_parameters(2),
        start=np.array([-4.0, -0.3]),
        minimum=target,
        lowest=0.0,
        residuals_at=lambda x: turned @ (x - target),
        jacobian_at=lambda _: turned,
    )
    return Cliff(problem=problem, beyond=lambda x: 4.0 - float(x @ x))


def wall_before_the_minimum() -> Cliff:
    """The linear problem with a flat wall halfway from the start: the minimum is out of reach."""
    problem = linear()
    normal = problem.minimum - problem.start
    wall = 0.5 * float(normal @ (problem.minimum + problem.start))
    return Cliff(problem=problem, beyond=lambda x: float(normal @ x) - wall)


def springs_with_a_ball(start: Array) -> Cliff:
    """The springs with a ball without prediction across the straight way to the reference."""
    problem = sloppy_springs()
    scales = np.array([3.0] * 4 + [2.0] * 4)
    # Beside the straight line, so that the way around is not a matter of chance.
    aside = np.array([1.0, -1, 1, -1, 1, -1, 1, -1])
    center = 0.5 * (start + problem.minimum) + 0.1 * scales * aside
    radius = 0.35 * float(np.linalg.norm((start - problem.minimum) / scales))

    def beyond(theta: Array) -> float:
        return radius - float(np.linalg.norm((theta - center) / scales))

    return Cliff(problem=problem, beyond=beyond)


def kinked() -> ClosedForm:
    """Three distances and a residual that grows on either side of a plane: least on that plane.

    There the derivatives of each side promise a decrease on the other.
    """
    away, normal = np.array([0.2, 0.2, 0.0]), np.full(3, 1.0 / np.sqrt(3.0))
    share = 0.18

    def jacobian(x: Array) -> Array:
        side = 1.0 if normal @ x >= 0.0 else -1.0
        return np.vstack([np.eye(3), share * side * normal])

    return ClosedForm(
        name="kinked",
        parameters=plain_parameters(3),
        start=np.array([-1.0, 1.0, 1.5]),
        minimum=away - normal * (normal @ away),
        lowest=0.5 * (100.0 + float(normal @ away) ** 2),
        residuals_at=lambda x: np.append(x - away, 10.0 + share * abs(normal @ x)),
        jacobian_at=jacobian,
    )


def many_kinks(seed: int) -> ClosedForm:
    """Three distances and four residuals that bend at a plane each, upward or downward."""
    generator = np.random.default_rng(seed)
    normals = generator.standard_normal((4, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    places, shares = generator.uniform(-1.0, 1.0, 4), generator.uniform(-0.3, 0.3, 4)
    away = generator.uniform(-0.5, 0.5, 3)

    def jacobian(x: Array) -> Array:
        sides = np.sign(normals @ x - places)
        return np.vstack([np.eye(3), (shares * sides)[:, None] * normals])

    return ClosedForm(
        name=f"many kinks {seed}",
        parameters=plain_parameters(3),
        start=generator.uniform(-2.0, 2.0, 3),
        minimum=np.full(3, np.nan),
        lowest=np.nan,
        residuals_at=lambda x: np.append(x - away, 5.0 + shares * abs(normals @ x - places)),
        jacobian_at=jacobian,
    )


EASY = (linear(), rosenbrock(), active_bounds(), sloppy_springs())
