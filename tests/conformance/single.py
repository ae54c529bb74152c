"""Cases of one parameter: shapes of the deviance."""

import math

import numpy as np

from conformance.case import Case, Formula
from conformance.construction import (
    FLAT,
    INF,
    Z,
    case,
    plain_parameters,
    single,
)

EITHER = "open_at_bound or open_flat"
ONE_SD = math.erf(math.sqrt(0.5))


def plain_cases() -> list[Case]:
    """Parabolas, in all sizes and with all kinds of offsets."""
    parabola = single(lambda x: (x - 1.0) / 0.3, lambda _: 1 / 0.3)
    exact = [(1.0 - 0.3 * Z, 1.0 + 0.3 * Z)]
    misfit = Formula(
        parameters=plain_parameters((-10.0, 10.0)),
        residuals_at=lambda theta: [1000.0, (theta[0] - 1.0) / 0.3],
        jacobian_at=lambda _: [[0.0], [1 / 0.3]],
    )
    return [
        case("quadratic", "the factor of two: 1.95996 sd", parabola, [1.0], exact),
        case(
            "quadratic at one sd",
            "levels other than 95 %",
            parabola,
            [1.0],
            [(0.7, 1.3)],
            level=ONE_SD,
        ),
        case("fit that stopped early", "an optimum 0.7 sd away", parabola, [1.21], exact),
        case("large misfit", "a rise of 4 above a deviance of a million", misfit, [1.0], exact),
        case(
            "tiny unit",
            "an interval of 1e-10 in a box of 1",
            single(lambda x: (x - 1e-9) / 1e-10, lambda _: 1e10, (-1.0, 1.0)),
            [1e-9],
            [(1e-9 - 1e-10 * Z, 1e-9 + 1e-10 * Z)],
        ),
        case(
            "large unit",
            "an interval of 1e7 in a box of 1e12",
            single(lambda x: (x - 1e9) / 1e7, lambda _: 1e-7, (-1e12, 1e12)),
            [1e9],
            [(1e9 - 1e7 * Z, 1e9 + 1e7 * Z)],
        ),
        case(
            "no bounds",
            "steps that are a share of the box",
            single(lambda x: x - 1.0, lambda _: 1.0, (-INF, INF)),
            [1.0],
            [(1.0 - Z, 1.0 + Z)],
        ),
    ]


def curved_cases() -> list[Case]:
    """One minimum, but no parabola."""
    return [
        case(
            "quartic",
            "no curvature at the optimum",
            single(lambda x: x * x, lambda x: 2.0 * x),
            [0.0],
            [(-math.sqrt(Z), math.sqrt(Z))],
        ),
        case(
            "logarithmic scale",
            "an upper side 19 times as long as the lower; no prediction at the lower bound",
            single(lambda x: np.log(x / 2.0) / 1.5, lambda x: 1.0 / (1.5 * x), (0.0, 1000.0)),
            [2.0],
            [(2.0 * math.exp(-1.5 * Z), 2.0 * math.exp(1.5 * Z))],
        ),
        case(
            "one side exponential",
            "the deviance below tends to 1 and never crosses",
            single(math.expm1, math.exp, (-100.0, 10.0)),
            [0.0],
            [(-INF, math.log1p(Z))],
            lower=FLAT,
        ),
        case(
            "saturating decay",
            "the classical practical non-identifiability: a rate too fast to be seen",
            single(
                lambda x: (math.exp(-x) - 0.05) / 0.1, lambda x: -10.0 * math.exp(-x), (-5.0, 1e3)
            ),
            [-math.log(0.05)],
            [(-math.log(0.05 + 0.1 * Z), INF)],
            upper=FLAT,
        ),
    ]


def asymptotic_cases() -> list[Case]:
    """Deviances that tend to a number on both sides."""
    return [
        case(
            "asymptote below",
            "both sides tend to 2.25 without bounds",
            single(
                lambda x: 1.5 * math.tanh(x), lambda x: 1.5 * (1 - math.tanh(x) ** 2), (-INF, INF)
            ),
            [0.0],
            [(-INF, INF)],
            lower=FLAT,
            upper=FLAT,
        ),
        case(
            "asymptote just above",
            "both sides tend to 4, little above the threshold of 3.84",
            single(
                lambda x: 2.0 * math.tanh(x), lambda x: 2 * (1 - math.tanh(x) ** 2), (-1e3, 1e3)
            ),
            [0.0],
            [(-math.atanh(0.5 * Z), math.atanh(0.5 * Z))],
        ),
    ]


def bent_cases() -> list[Case]:
    """Kinks and plateaus."""

    def kink_on_the_way(x: float) -> float:
        return x if x < 1.0 else 1.0 + 10.0 * (x - 1.0)

    def plateau(x: float) -> float:
        return min(x, 1.5) + max(x - 4.5, 0.0)

    def smooth_plateau(x: float) -> float:
        return 1.8 * math.tanh(x) + 1e-3 * x**3

    return [
        case(
            "kink at the optimum",
            "derivatives that differ on both sides of the optimum",
            single(lambda x: (2.0 if x > 1 else 0.5) * (x - 1), lambda x: 2.0 if x > 1 else 0.5),
            [1.0],
            [(1.0 - 2.0 * Z, 1.0 + 0.5 * Z)],
        ),
        case(
            "kink on the way",
            "a slope ten times as steep from one standard deviation on",
            single(kink_on_the_way, lambda x: 1.0 if x < 1 else 10.0),
            [0.0],
            [(-Z, 1.0 + (Z - 1.0) / 10.0)],
        ),
        case(
            "plateau, then rise",
            "a deviance that rests at 2.25, exactly flat, and then crosses",
            single(plateau, lambda x: float(x < 1.5 or x > 4.5), (-20.0, 20.0)),
            [0.0],
            [(-Z, 4.5 + (Z - 1.5))],
        ),
        case(
            "smooth plateau, then rise",
            "a deviance nearly at rest at 3.24 that crosses much further out",
            single(
                smooth_plateau,
                lambda x: 1.8 * (1 - math.tanh(x) ** 2) + 3e-3 * x**2,
                (-100.0, 100.0),
            ),
            [0.0],
            # The root of 1.8 tanh(x) + x^3 / 1000 = Z.
            [(-SMOOTH_PLATEAU_END, SMOOTH_PLATEAU_END)],
        ),
    ]


def broken_cases() -> list[Case]:
    """Jumps and noise."""
    return [
        case(
            "jump inside the interval",
            "a discontinuity below the threshold",
            single(lambda x: x if x < 1 else x + 0.5, lambda _: 1.0),
            [0.0],
            [(-Z, Z - 0.5)],
        ),
        case(
            "jump across the threshold",
            "an interval that ends at a discontinuity",
            single(lambda x: x if x < 1 else x + 3.0, lambda _: 1.0),
            [0.0],
            [(-Z, 1.0)],
        ),
        case(
            "noisy residuals",
            "noise of 1e-4 in the residuals, as of an inner solver, that derivatives do not see",
            single(lambda x: (x - 1) / 0.3 + 1e-4 * math.sin(1e6 * x), lambda _: 1 / 0.3),
            [1.0],
            [(1.0 - 0.3 * Z, 1.0 + 0.3 * Z)],
        ),
    ]


SMOOTH_PLATEAU_END = 5.429211311082917


def disjoint_cases() -> list[Case]:
    """More than one minimum."""
    near, far = math.sqrt(4.0 - Z), math.sqrt(4.0 + Z)
    stiff_near, stiff_far = math.sqrt(4.0 - 0.1 * Z), math.sqrt(4.0 + 0.1 * Z)
    reach = math.asin(Z / 3.0)
    periods = [(k * math.pi - reach, k * math.pi + reach) for k in range(-3, 4)]
    return [
        case(
            "two minima",
            "a second minimum just as good, behind a rise to 16",
            single(lambda x: x * x - 4, lambda x: 2 * x, (-7.0, 31.0)),
            [2.0],
            [(-far, -near), (near, far)],
        ),
        case(
            "two minima, high barrier",
            "the same behind a rise to 1,600",
            single(lambda x: 10 * (x * x - 4), lambda x: 20 * x, (-40.0, 15.0)),
            [2.0],
            [(-stiff_far, -stiff_near), (stiff_near, stiff_far)],
        ),
        case(
            "seven minima",
            "a wave, cut by the bounds inside its outer minima",
            single(lambda x: 3 * math.sin(x), lambda x: 3 * math.cos(x), (-9.5, 9.8)),
            [0.0],
            [(-INF, periods[0][1]), *periods[1:-1], (periods[-1][0], INF)],
        ),
        _better_optimum("better optimum hidden", "a fit that ended in the poorer minimum", 1.0),
        _better_optimum(
            "both optima allowed", "a better minimum elsewhere and the poorer one allowed too", 4.0
        ),
    ]


def _better_optimum(name: str, about: str, width: float) -> Case:
    """Deviance ``(x^2 - 4)^2 + ((x - 2) / width)^2``: least at 2, with another minimum near -2."""
    problem = Formula(
        parameters=plain_parameters((-6.0, 22.0)),
        residuals_at=lambda theta: [theta[0] ** 2 - 4.0, (theta[0] - 2.0) / width],
        jacobian_at=lambda theta: [[2.0 * theta[0]], [1.0 / width]],
    )
    deviance = np.polynomial.Polynomial([-4.0, 0.0, 1.0]) ** 2
    deviance += np.polynomial.Polynomial([-2.0 / width, 1.0 / width]) ** 2
    poorer = min(_real(deviance.deriv().roots()))
    ends = _real((deviance - Z**2).roots())
    return case(name, about, problem, [poorer], list(zip(ends[::2], ends[1::2], strict=True)))


def _real(roots: np.ndarray) -> list[float]:
    return sorted(float(x.real) for x in np.atleast_1d(roots) if abs(x.imag) < 1e-9)
