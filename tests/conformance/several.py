"""Cases of several parameters: what can be told apart, and what cannot."""

import math

import numpy as np

from conformance.case import Case, Formula
from conformance.construction import (
    FLAT,
    INF,
    Z,
    case,
    function,
    linear,
    plain_parameters,
)
from identknee.calibrate.problem import ParameterQuantity
from identknee.runs.declare import Array

STRUCTURALLY = {"lower": FLAT, "upper": FLAT, "verdict": "structurally_suspect"}
WIDE = (-1e3, 1e3)
# Where min over x of 100 (y - x^2)^2 + (x - 1)^2 crosses the threshold.
BANANA = (-0.16941250180477896, 8.763042145004986)
# Where min over y of 100 (x - y^3 + 3 y)^2 + ((y - a) / s)^2 crosses it, for (a, s) = (0, 1.5) and
# (0.6, 0.74).
FOLDED, SHORTCUT = 16.5912301533, (-2.1885185741, 2.4700906056)
# Where the lowest deviance of the saturating response crosses it; it tends to 0.335 above.
SATURATION_LOW = 0.2516526488456317


def linear_cases() -> list[Case]:
    """Linear problems, whose intervals follow from the normal equations."""
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
    stiff = np.diag([1e4, 1.0]) @ turn
    sloppier = np.diag([1e8, 1.0]) @ turn
    many = rng.normal(size=(60, 30))
    few = rng.normal(size=(4, 5))
    # The first parameter has data of its own, the other three share two.
    known = np.array([[5.0, 0, 0, 0], [0, 1.0, 1.0, 0], [0, 0, 1.0, 1.0]])
    redundant = np.array([[1.0, 0.5, 0.5], [0.0, 1.0, 1.0], [0.5, 0.2, 0.2]])
    return [
        _linear(
            "correlated, with noise", "residuals left at the optimum", rng.normal(size=(12, 3))
        ),
        _linear("condition 1e8", "information 1e8 times larger one way than the other", stiff),
        _linear("condition 1e16", "the same, 1e16 times", sloppier),
        case(
            "stiff beside sloppy",
            "an interval of 2e-4 in a box of 2,000, beside a parameter known to 1",
            linear(np.diag([1e4, 1.0]), np.array([3e4, 0.0]), WIDE, WIDE),
            [3.0, 0.0],
            [(3.0 - 1e-4 * Z, 3.0 + 1e-4 * Z)],
        ),
        _linear("thirty parameters", "size", many),
        case(
            "fewer data than parameters",
            "four data for five parameters: any value fits exactly",
            linear(few, np.zeros(4), *[(-10.0, 10.0)] + [(-1e4, 1e4)] * 4),
            np.zeros(5),
            [(-INF, INF)],
            **STRUCTURALLY,
        ),
        case(
            "fewer data than parameters, one known",
            "a singular problem that says nothing of the parameter asked about",
            linear(known, np.zeros(3), *[(-100.0, 100.0)] * 4),
            np.zeros(4),
            [(-Z / 5.0, Z / 5.0)],
        ),
        _linear("redundant nuisance", "two others of which only the sum is known", redundant),
    ]


def structural_cases() -> list[Case]:
    """Combinations that are known while their parts are not."""
    sums = linear(np.array([[10.0, 10.0]]), np.array([30.0]), (-10.0, 10.0), (-100.0, 100.0))
    product = Formula(
        parameters=plain_parameters((0.1, 20.0), (0.01, 1000.0)),
        residuals_at=lambda theta: [(theta[0] * theta[1] - 6.0) / 0.5],
        jacobian_at=lambda theta: [[2.0 * theta[1], 2.0 * theta[0]]],
    )
    absent = linear(np.array([[0.0, 2.0]]), np.array([1.0]), (-5.0, 5.0), (-5.0, 5.0))
    return [
        case(
            "absent parameter",
            "data that do not depend on the parameter",
            absent,
            [0.0, 0.5],
            [(-INF, INF)],
            **STRUCTURALLY,
        ),
        case("sum only", "x + y is known", sums, [1.0, 2.0], [(-INF, INF)], **STRUCTURALLY),
        case("product only", "x y is known", product, [2.0, 3.0], [(-INF, INF)], **STRUCTURALLY),
        case(
            "the sum itself",
            "a function that is known while its parts are not",
            sums,
            [1.0, 2.0],
            [(3.0 - 0.1 * Z, 3.0 + 0.1 * Z)],
            quantity=function("x0 + x1", lambda theta: float(theta[0] + theta[1])),
        ),
        case(
            "the product itself",
            "the same with a curved function",
            product,
            [2.0, 3.0],
            [(6.0 - 0.5 * Z, 6.0 + 0.5 * Z)],
            quantity=function("x0 x1", lambda theta: float(theta[0] * theta[1])),
        ),
    ]


def curved_cases() -> list[Case]:
    """Bent valleys and branches."""
    valley = Formula(
        parameters=plain_parameters((-10.0, 10.0), (-10.0, 100.0)),
        residuals_at=lambda theta: [10.0 * (theta[1] - theta[0] ** 2), theta[0] - 1.0],
        jacobian_at=lambda theta: [[-20.0 * theta[0], 10.0], [1.0, 0.0]],
    )
    second = ParameterQuantity(parameters=valley.parameters, name="x1.value")
    return [
        case(
            "banana",
            "a bent valley, along its axis",
            valley,
            [1.0, 1.0],
            [(1.0 - Z, 1.0 + Z)],
        ),
        case(
            "banana, across",
            "the same for the other parameter: its path turns back at zero",
            valley,
            [1.0, 1.0],
            [BANANA],
            quantity=second,
        ),
        _exchangeable(),
        _branches("two branches", "one interval, half of it on another branch", 1.5),
        _branches("two branches apart", "two intervals, one of them on another branch", 3.0),
        case(
            "folded path",
            "a path that turns back twice: the fits must jump, without another minimum anywhere",
            _folded(0.0, 1.5),
            [0.0, 0.0],
            [(-FOLDED, FOLDED)],
        ),
        case(
            "shortcut",
            "a part of a folded path that is allowed beyond the end of the part with the optimum",
            _folded(0.6, 0.74),
            [0.6**3 - 1.8, 0.6],
            [SHORTCUT],
        ),
        case(
            "saturation",
            "the maximum of a saturating response measured below its half: open above",
            _saturation(),
            [1.0, 1.0],
            [(SATURATION_LOW, INF)],
            upper=f"{FLAT} or open_at_bound",
        ),
    ]


def _linear(name: str, about: str, matrix: Array) -> Case:
    """The first parameter of a linear problem with data that it does not fit exactly."""
    m, n = matrix.shape
    rng = np.random.default_rng(n)
    data = matrix @ rng.uniform(-2.0, 2.0, n) + rng.normal(size=m)
    inverse = np.linalg.pinv(matrix, rcond=1e-12)
    optimum = inverse @ data
    reach = Z * math.sqrt(float(inverse[0] @ inverse[0]))
    interval = (float(optimum[0]) - reach, float(optimum[0]) + reach)
    return case(name, about, linear(matrix, data, *[WIDE] * n), optimum, [interval])


def _exchangeable() -> Case:
    """Sum 3 and product 2 known to 0.05: one parameter is 1 and the other 2.

    The best second parameter is linear least squares, which leaves the deviance
    ``(x^2 - 3 x + 2)^2 / (1 + x^2) / 0.05^2``.
    """
    problem = Formula(
        parameters=plain_parameters((0.0, 9.0), (0.0, 9.0)),
        residuals_at=lambda theta: (
            np.array([theta[0] + theta[1] - 3.0, theta[0] * theta[1] - 2.0]) / 0.05
        ),
        jacobian_at=lambda theta: np.array([[1.0, 1.0], [theta[1], theta[0]]]) / 0.05,
    )
    height = np.polynomial.Polynomial([2.0, -3.0, 1.0]) ** 2
    height -= np.polynomial.Polynomial([1.0, 0.0, 1.0]) * (0.05 * Z) ** 2
    ends = sorted(float(x) for x in height.roots().real)
    return case(
        "exchangeable parameters",
        "two solutions with the parameters' roles exchanged",
        problem,
        [1.0, 2.0],
        [(ends[0], ends[1]), (ends[2], ends[3])],
    )


def _branches(name: str, about: str, apart: float) -> Case:
    """Two minima in a second parameter, at -1 and 1, that want the first at -`apart` and `apart`.

    Where the second is 1 or -1 its own residual vanishes with its slope in the first, so that the
    deviance of either branch is exactly ``(x -+ apart)^2``.
    """

    def residuals(theta: Array) -> list[float]:
        x, y = theta
        return [10.0 * (y * y - 1.0), x - 0.5 * apart * y * (3.0 - y * y)]

    def jacobian(theta: Array) -> list[list[float]]:
        y = theta[1]
        return [[0.0, 20.0 * y], [1.0, -1.5 * apart * (1.0 - y * y)]]

    problem = Formula(
        parameters=plain_parameters((-10.0, 25.0), (-2.0, 5.0)),
        residuals_at=residuals,
        jacobian_at=jacobian,
    )
    ends = [(-apart - Z, -apart + Z), (apart - Z, apart + Z)]
    intervals = ends if ends[0][1] < ends[1][0] else [(ends[0][0], ends[1][1])]
    return case(name, about, problem, [apart, 1.0], intervals)


def _folded(center: float, sd: float) -> Formula:
    """The first parameter follows ``y^3 - 3 y`` of the second, of which one value is likely."""
    return Formula(
        parameters=plain_parameters((-40.0, 55.0), (-6.0, 8.0)),
        residuals_at=lambda theta: [
            10.0 * (theta[0] - theta[1] ** 3 + 3.0 * theta[1]),
            (theta[1] - center) / sd,
        ],
        jacobian_at=lambda theta: [[10.0, 30.0 * (1.0 - theta[1] ** 2)], [0.0, 1.0 / sd]],
    )


def _saturation() -> Formula:
    """Response ``V s / (K + s)`` at four small s, noise 0.05; the data have V = K = 1."""
    doses = np.array([0.05, 0.1, 0.2, 0.4])
    data = doses / (1.0 + doses)

    def residuals(theta: Array) -> Array:
        return np.asarray((theta[0] * doses / (theta[1] + doses) - data) / 0.05)

    def jacobian(theta: Array) -> Array:
        by_maximum = doses / (theta[1] + doses)
        by_half = -theta[0] * doses / (theta[1] + doses) ** 2
        return np.stack([by_maximum, by_half], axis=1) / 0.05

    return Formula(
        parameters=plain_parameters((0.0, 1e3), (0.0, 1e4)),
        residuals_at=residuals,
        jacobian_at=jacobian,
    )
