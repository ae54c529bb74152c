"""The field model again in slow plain Python: loops over points and lines, no tricks.

Energy of a pose, its gradient written out, and everything else by complex steps: the imaginary part
of a function of ``x + ih`` over ``h`` is its derivative to rounding, since nothing is subtracted.
Wherever the model decides by a sign, the real part decides.

Poses are (varus, internal [rad], x, y, z [mm]) at a fixed flexion [rad]:
``x_femur = R x_tibia + Rz(-flexion) (x, y, z)`` with ``R = Rz(-flexion) Rx(varus) Ry(internal)``.
Loads are generalised: (varus, internal moment [N mm], forces of x, y, z [N]). Energies are in N mm.
"""

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

Number = Any  # float or complex
Vector = Sequence[Number]
Matrix = list[list[Number]]

STEP = 1e-30  # of complex steps; its square vanishes beside anything
MM_PER_RADIAN = 40.0  # what makes angles and lengths comparable


@dataclass(frozen=True, kw_only=True)
class OracleKnee:
    """What the model is made of, in nested lists.

    coefficients[i][j][k]: of the cubic B-spline of the signed distance [mm], nodes at origin +
    spacing (i, j, k); points and areas of the tibial contact points [mm, mm2]; femoral and tibial
    insertions [mm]; reference lengths [mm]; pressure modulus [N/mm3]; transition strain.
    """

    coefficients: list[list[list[float]]]
    origin: list[float]
    spacing: float
    points: list[list[float]]
    areas: list[float]
    femoral: list[list[float]]
    tibial: list[list[float]]
    reference_length: list[float]
    pressure: float = 10.0
    transition: float = 0.03


@dataclass(frozen=True, kw_only=True)
class State:
    """A trial and the ligaments' parameters: stiffness [N], reference strain [-]."""

    flexion: float
    load: Vector
    stiffness: Vector
    strain: Vector


# --- energy -------------------------------------------------------------------------------------


def energy(knee: OracleKnee, state: State, pose: Vector) -> Number:
    """Contact and ligament energy less the work of the load [N mm]."""
    rotation = rotation_of(state.flexion, pose[0], pose[1])
    translation = apply(rotation_of(state.flexion, 0.0, 0.0), pose[2:])
    total: Number = 0.0
    for point, area in zip(knee.points, knee.areas, strict=True):
        depth = distance(knee, move(rotation, translation, point))
        if real(depth) < 0.0:
            total += 0.5 * knee.pressure * area * depth * depth
    for line in range(len(knee.reference_length)):
        length = norm(line_vector(knee, rotation, translation, line))
        slack_length = knee.reference_length[line] / (1.0 + state.strain[line])
        elongation = length / slack_length - 1.0
        stored = stored_energy(elongation, state.stiffness[line], knee.transition)
        total += slack_length * stored
    for coordinate, load in zip(pose, state.load, strict=True):
        total -= load * coordinate
    return total


def stored_energy(strain: Number, stiffness: Number, transition: float) -> Number:
    """Integral of the tension over strain: the energy of a line per unit of slack length [N]."""
    if real(strain) <= 0.0:
        return 0.0
    if real(strain) <= 2.0 * transition:
        return stiffness * strain**3 / (12.0 * transition)
    end_of_toe = stiffness * (2.0 * transition) ** 3 / (12.0 * transition)
    linear_part = ((strain - transition) ** 2 - transition**2) / 2.0
    return end_of_toe + stiffness * linear_part


def tension(strain: Number, stiffness: Number, transition: float) -> Number:
    """Equation 3 of the paper [N]."""
    if real(strain) <= 0.0:
        return 0.0
    if real(strain) <= 2.0 * transition:
        return stiffness * strain**2 / (4.0 * transition)
    return stiffness * (strain - transition)


def distance(knee: OracleKnee, place: Vector) -> Number:
    """The field at `place` [mm]; 1 where the spline lacks support."""
    return field(knee, place, derivative=None)


def distance_gradient(knee: OracleKnee, place: Vector) -> list[Number]:
    """Derivative of the field by the three coordinates of `place`."""
    return [field(knee, place, derivative=axis) / knee.spacing for axis in range(3)]


def field(knee: OracleKnee, place: Vector, derivative: int | None) -> Number:
    """The sum over the 4 x 4 x 4 coefficients, one axis' weights differentiated if asked."""
    shape = (
        len(knee.coefficients),
        len(knee.coefficients[0]),
        len(knee.coefficients[0][0]),
    )
    first: list[int] = []
    weights: list[list[Number]] = []
    for axis in range(3):
        u = (place[axis] - knee.origin[axis]) / knee.spacing
        cell = math.floor(real(u))
        if cell < 1 or cell + 2 > shape[axis] - 1:
            return 1.0
        first.append(cell - 1)
        weigh = spline_slopes if derivative == axis else spline_weights
        weights.append(weigh(u - cell))
    total: Number = 0.0
    for a in range(4):
        for b in range(4):
            row = knee.coefficients[first[0] + a][first[1] + b]
            for c in range(4):
                total += row[first[2] + c] * weights[0][a] * weights[1][b] * weights[2][c]
    return total


def spline_weights(t: Number) -> list[Number]:
    """Uniform cubic B-spline at t in [0, 1): weights of the nodes -1, 0, 1, 2."""
    return [
        (1.0 - t) ** 3 / 6.0,
        (3.0 * t**3 - 6.0 * t**2 + 4.0) / 6.0,
        (-3.0 * t**3 + 3.0 * t**2 + 3.0 * t + 1.0) / 6.0,
        t**3 / 6.0,
    ]


def spline_slopes(t: Number) -> list[Number]:
    """Derivatives of the weights by t."""
    return [
        -((1.0 - t) ** 2) / 2.0,
        (9.0 * t**2 - 12.0 * t) / 6.0,
        (-9.0 * t**2 + 6.0 * t + 3.0) / 6.0,
        t**2 / 2.0,
    ]


# --- derivatives --------------------------------------------------------------------------------


def gradient(knee: OracleKnee, state: State, pose: Vector) -> list[Number]:
    """Derivative of the energy by the pose, written out: minus the generalised force."""
    rotation = rotation_of(state.flexion, pose[0], pose[1])
    flexed = rotation_of(state.flexion, 0.0, 0.0)
    translation = apply(flexed, pose[2:])
    turns = rotation_slopes(state.flexion, pose[0], pose[1])
    total: list[Number] = [-load for load in state.load]

    def add(point: Vector, push: Vector) -> None:
        """Add the slope of an energy whose derivative by the point's position is `push`."""
        for k in range(2):
            total[k] += dot(push, apply(turns[k], point))
        for k in range(3):
            total[2 + k] += dot(push, [flexed[i][k] for i in range(3)])

    for point, area in zip(knee.points, knee.areas, strict=True):
        place = move(rotation, translation, point)
        depth = distance(knee, place)
        if real(depth) < 0.0:
            size = knee.pressure * area * depth
            add(point, [size * slope for slope in distance_gradient(knee, place)])
    for line, tibial in enumerate(knee.tibial):
        vector = line_vector(knee, rotation, translation, line)
        length = norm(vector)
        strain = length * (1.0 + state.strain[line]) / knee.reference_length[line] - 1.0
        pull = tension(strain, state.stiffness[line], knee.transition)
        add(tibial, [pull * component / length for component in vector])
    return total


def gradient_by_complex_step(knee: OracleKnee, state: State, pose: Vector) -> list[float]:
    """Derivative of the energy by the pose, from the energy alone."""
    return [energy(knee, state, stepped(pose, k)).imag / STEP for k in range(5)]


def hessian(knee: OracleKnee, state: State, pose: Vector) -> list[list[float]]:
    """Second derivatives of the energy, by complex steps of the gradient; column k last."""
    columns = [gradient(knee, state, stepped(pose, k)) for k in range(5)]
    return [[complex(columns[k][i]).imag / STEP for k in range(5)] for i in range(5)]


def parameter_slopes(knee: OracleKnee, state: State, pose: Vector) -> list[list[float]]:
    """Derivatives of the gradient (5) by all stiffnesses [N], then all reference strains."""
    n = len(state.stiffness)
    columns = []
    for k in range(2 * n):
        shifted = State(
            flexion=state.flexion,
            load=state.load,
            stiffness=stepped(state.stiffness, k) if k < n else state.stiffness,
            strain=state.strain if k < n else stepped(state.strain, k - n),
        )
        columns.append(gradient(knee, shifted, pose))
    return [[complex(column[i]).imag / STEP for column in columns] for i in range(5)]


def sensitivities(knee: OracleKnee, state: State, pose: Vector) -> np.ndarray:
    """Slope of an equilibrium by the parameters, shape (5, 2n): the implicit function theorem."""
    slopes: np.ndarray = -np.linalg.solve(
        np.array(hessian(knee, state, pose)), np.array(parameter_slopes(knee, state, pose))
    )
    return slopes


def independent_minimum(
    knee: OracleKnee, state: State, start: Vector, *, tolerance: float = 1e-6
) -> tuple[np.ndarray, float]:
    """A minimum of the energy near `start` and its residual [N], by scipy's trust region method.

    Angles are multiplied by 40 mm inside, and moments divided by it in the residual. The caller
    judges the residual: the search stops below `tolerance` [N] or where rounding ends it.
    """
    scale = np.array([MM_PER_RADIAN, MM_PER_RADIAN, 1.0, 1.0, 1.0])

    def in_mm(function: Callable[..., Any]) -> Callable[[np.ndarray], Any]:
        return lambda x: function(knee, state, (x / scale).tolist())

    value, slope, curvature = in_mm(energy), in_mm(gradient), in_mm(hessian)
    found = minimize(
        value,
        np.array(start, float) * scale,
        jac=lambda x: np.array(slope(x)) / scale,
        hess=lambda x: np.array(curvature(x)) / scale / scale[:, None],
        method="trust-exact",
        options={"gtol": tolerance, "initial_trust_radius": 0.5, "max_trust_radius": 3.0},
    )
    return found.x / scale, float(np.linalg.norm(np.array(slope(found.x)) / scale))


# --- geometry -----------------------------------------------------------------------------------


def rotation_of(flexion: Number, varus: Number, internal: Number) -> Matrix:
    """Rz(-flexion) Rx(varus) Ry(internal)."""
    about_z = [
        [cosine(flexion), sine(flexion), 0.0],
        [-sine(flexion), cosine(flexion), 0.0],
        [0.0, 0.0, 1.0],
    ]
    about_x = [
        [1.0, 0.0, 0.0],
        [0.0, cosine(varus), -sine(varus)],
        [0.0, sine(varus), cosine(varus)],
    ]
    about_y = [
        [cosine(internal), 0.0, sine(internal)],
        [0.0, 1.0, 0.0],
        [-sine(internal), 0.0, cosine(internal)],
    ]
    return multiply(multiply(about_z, about_x), about_y)


def rotation_slopes(flexion: Number, varus: Number, internal: Number) -> tuple[Matrix, Matrix]:
    """Derivatives of the rotation by varus and by internal rotation."""
    about_z = rotation_of(flexion, 0.0, 0.0)
    about_x = rotation_of(0.0, varus, 0.0)
    about_y = rotation_of(0.0, 0.0, internal)
    slope_x = [
        [0.0, 0.0, 0.0],
        [0.0, -sine(varus), -cosine(varus)],
        [0.0, cosine(varus), -sine(varus)],
    ]
    slope_y = [
        [-sine(internal), 0.0, cosine(internal)],
        [0.0, 0.0, 0.0],
        [-cosine(internal), 0.0, -sine(internal)],
    ]
    return (
        multiply(multiply(about_z, slope_x), about_y),
        multiply(multiply(about_z, about_x), slope_y),
    )


def line_vector(knee: OracleKnee, rotation: Matrix, translation: Vector, line: int) -> list[Number]:
    """From the femoral to the tibial insertion [mm]."""
    place = move(rotation, translation, knee.tibial[line])
    return [place[i] - knee.femoral[line][i] for i in range(3)]


def move(rotation: Matrix, translation: Vector, point: Vector) -> list[Number]:
    """A tibial point in femoral axes."""
    turned = apply(rotation, point)
    return [turned[i] + translation[i] for i in range(3)]


def multiply(left: Matrix, right: Matrix) -> Matrix:
    """Product of two 3 x 3 matrices."""
    return [[sum(left[i][k] * right[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def apply(matrix: Matrix, vector: Vector) -> list[Number]:
    """Product of a 3 x 3 matrix and a vector."""
    return [dot(row, vector) for row in matrix]


def dot(left: Vector, right: Vector) -> Number:
    """Sum of products, without complex conjugation."""
    return left[0] * right[0] + left[1] * right[1] + left[2] * right[2]


def norm(vector: Vector) -> Number:
    """Length of a vector."""
    square = dot(vector, vector)
    return cmath.sqrt(square) if isinstance(square, complex) else math.sqrt(square)


def sine(angle: Number) -> Number:
    """Of a real or a complex angle."""
    return cmath.sin(angle) if isinstance(angle, complex) else math.sin(angle)


def cosine(angle: Number) -> Number:
    """Of a real or a complex angle."""
    return cmath.cos(angle) if isinstance(angle, complex) else math.cos(angle)


def real(number: Number) -> float:
    """The real part, which decides wherever the model branches."""
    return float(number.real)


def stepped(values: Vector, index: int) -> list[Number]:
    """`values` with an imaginary step in one of them."""
    return [value + 1j * STEP if i == index else value for i, value in enumerate(values)]
