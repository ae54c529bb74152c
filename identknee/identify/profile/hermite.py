"""Curves through points with known slopes."""

from itertools import pairwise

import scipy.optimize

from identknee.runs.arrays import Array


def cubic(x: float, left: tuple[float, float, float], right: tuple[float, float, float]) -> float:
    """Value at `x` of the cubic through two points, each given as (place, value, slope).

    Examples
    --------
    >>> cubic(0.5, (0.0, 0.0, 0.0), (1.0, 1.0, 3.0))
    0.125
    """
    (a, f, slope_f), (b, g, slope_g) = left, right
    width = b - a
    u = (x - a) / width
    return float(
        (1 + 2 * u) * (1 - u) ** 2 * f
        + u * (1 - u) ** 2 * width * slope_f
        + u**2 * (3 - 2 * u) * g
        + u**2 * (u - 1) * width * slope_g
    )


def crossings(places: Array, values: Array, slopes: Array, level: float) -> list[float]:
    """Where the piecewise cubic through points with slopes crosses `level`, from low to high.

    Between two points on different sides of the level there is one crossing; others are not sought.
    """
    found = []
    points = list(zip(places.tolist(), values.tolist(), slopes.tolist(), strict=True))
    for left, right in pairwise(points):
        if (left[1] < level) != (right[1] < level):
            found.append(
                float(
                    scipy.optimize.brentq(
                        lambda x, a=left, b=right: cubic(x, a, b) - level, left[0], right[0]
                    )
                )
            )
    return found
