"""Cases at the edges: bounds, and places without a prediction."""

import math
from dataclasses import replace

import numpy as np

from conformance.case import Case, Formula
from conformance.construction import (
    FEASIBILITY,
    FLAT,
    INF,
    Z,
    case,
    linear,
    plain_parameters,
    single,
)


def bound_cases() -> list[Case]:
    """Bounds of the parameter asked about."""
    return [
        case(
            "open above",
            "a bound before the upper end",
            single(lambda x: (x - 1) / 2, lambda _: 0.5, (-10.0, 2.0)),
            [1.0],
            [(1.0 - 2.0 * Z, INF)],
        ),
        case(
            "open on both sides",
            "bounds before both ends",
            single(lambda x: x / 10, lambda _: 0.1, (-2.0, 3.0)),
            [0.0],
            [(-INF, INF)],
        ),
        case(
            "minimum at a bound",
            "a deviance that still falls at the lower bound",
            single(lambda x: x + 1, lambda _: 1.0, (0.0, 5.0)),
            [0.0],
            [(-INF, math.sqrt(1.0 + Z**2) - 1.0)],
        ),
    ]


def near_bound_cases() -> list[Case]:
    """Bounds next to the optimum or to an end."""
    below, end = 1.0 - 0.3 * Z, 1.0 + 0.3 * Z
    return [
        case(
            "one rounding below a bound",
            "an optimum with one floating-point number between it and its bound",
            _tenths((-10.0, np.nextafter(1.0, 2.0))),
            [1.0],
            [(below, INF)],
        ),
        case(
            "one rounding above a bound",
            "an optimum out of bounds by the last bit, as after a transformation",
            _tenths((-10.0, np.nextafter(1.0, 0.0))),
            [1.0],
            [(below, INF)],
        ),
        case(
            "end just inside a bound",
            "an end a millionth of the half-width before the bound",
            _tenths((-10.0, end + 1e-6 * 0.3 * Z)),
            [1.0],
            [(below, end)],
        ),
        case(
            "end just outside a bound",
            "an end a millionth of the half-width beyond the bound",
            _tenths((-10.0, end - 1e-6 * 0.3 * Z)),
            [1.0],
            [(below, INF)],
        ),
    ]


def nuisance_cases() -> list[Case]:
    """Bounds of the other parameter."""
    tilted = np.array([[1.0, 1.0], [0.0, 0.5]])
    sums = np.array([[10.0, 10.0]])
    return [
        case(
            "nuisance pinned at its bounds",
            "a rise that changes where the other parameter can follow no further",
            linear(tilted, np.zeros(2), (-10.0, 10.0), (-0.5, 0.5)),
            [0.0, 0.0],
            # Beyond 0.5 (1 + 1/4) the other one is at its bound: (x - 0.5)^2 + 0.0625.
            [(-0.5 - math.sqrt(Z**2 - 0.0625), 0.5 + math.sqrt(Z**2 - 0.0625))],
            # Between -1 and 1 the ends move by 9 % of the interval: data make them, but barely.
            verdict="identifiable or bounded_by_assumption",
        ),
        case(
            "closed by the bound of another",
            "a sum alone is known; each part ends where the other reaches its bound",
            linear(sums, np.array([30.0]), (-100.0, 100.0), (0.0, 10.0)),
            [1.0, 2.0],
            [(-7.0 - 0.1 * Z, 3.0 + 0.1 * Z)],
            verdict="bounded_by_assumption",
        ),
    ]


def cliff_cases() -> list[Case]:
    """Places without a prediction, where the data exclude nothing."""
    plain = single(lambda x: x, lambda _: 1.0)
    cut = replace(plain, is_feasible=lambda theta: bool(theta[0] <= 1.0))
    band = replace(plain, is_feasible=lambda theta: not 1.0 < theta[0] < 1.2)
    slope = np.array([[1.0, -1.0], [0.0, 0.1]])
    beside = replace(
        linear(slope, np.zeros(2), (-10.0, 10.0), (-10.0, 10.0)),
        is_feasible=lambda theta: bool(theta[1] <= 0.5),
    )
    return [
        case(
            "cliff",
            "no prediction beyond 1, where the rise is 1",
            cut,
            [0.0],
            [(-Z, INF)],
            upper=FEASIBILITY,
        ),
        case(
            "gap",
            "no prediction between 1 and 1.2, and allowed values beyond: one set",
            band,
            [0.0],
            [(-Z, Z)],
        ),
        case(
            "cliff beside the path",
            "the other parameter can follow up to a cliff only",
            beside,
            [0.0, 0.0],
            # The other one would follow freely, x^2 / 101. Above it stops at 0.5, and the rise to
            # the threshold at 0.5 + sqrt(Z^2 - 0.0025) is the boundary's, not the data's.
            [(-INF, INF)],
            upper=FEASIBILITY,
        ),
        case(
            "slack ligament",
            "no force at all below a strain, measured as none: flat below, closed above",
            _slack(),
            [-2.0],
            [(-INF, 0.1 * Z)],
            lower=FLAT,
        ),
    ]


def _tenths(bounds: tuple[float, float]) -> Formula:
    return single(lambda x: (x - 1) / 0.3, lambda _: 1 / 0.3, bounds)


def _slack() -> Formula:
    """Five strains, taut in turn; the first becomes taut at zero and decides alone."""
    offsets = np.array([0.0, -1.0, -2.0, -3.0, -4.0])
    return Formula(
        parameters=plain_parameters((-10.0, 10.0)),
        residuals_at=lambda theta: np.maximum(theta[0] + offsets, 0.0) / 0.1,
        jacobian_at=lambda theta: (theta[0] + offsets > 0.0)[:, None] / 0.1,
    )
