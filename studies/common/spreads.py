"""Median and spread of some values, and both as text."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

BOOTSTRAP_DRAWS = 9999


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Median and spread of some values.

    Attributes
    ----------
    median, low, high
        Median, smallest and largest.
    ci_low, ci_high
        95 % bootstrap interval of the median.
    n
        How many values; those not finite are left out and not counted.
    """

    median: float
    low: float
    high: float
    ci_low: float
    ci_high: float
    n: int


def spread(values: ArrayLike, *, seed: int = 0) -> Spread:
    """Median, range and 95 % percentile-bootstrap interval of the median; NaN without values.

    Examples
    --------
    >>> spread([1.0, 2.0, 9.0]).median
    2.0
    """
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return Spread(median=np.nan, low=np.nan, high=np.nan, ci_low=np.nan, ci_high=np.nan, n=0)
    rows = np.random.default_rng(seed).integers(known.size, size=(BOOTSTRAP_DRAWS, known.size))
    low, high = np.quantile(np.median(known[rows], axis=1), [0.025, 0.975])
    return Spread(
        median=float(np.median(known)),
        low=float(known.min()),
        high=float(known.max()),
        ci_low=float(low),
        ci_high=float(high),
        n=int(known.size),
    )


def median_range(values: Spread, decimals: int = 2) -> str:
    """A spread as text: the median, and the range in brackets.

    Examples
    --------
    >>> median_range(spread([1.0, 2.0, 9.0]), 1)
    '2.0 [1.0, 9.0]'
    """
    if not values.n:
        return "-"
    low, high = f"{values.low:.{decimals}f}", f"{values.high:.{decimals}f}"
    return f"{values.median:.{decimals}f} [{low}, {high}]"
