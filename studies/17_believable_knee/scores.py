"""How well predictions with intervals did: coverage, interval score, and the difference of two."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from identknee.runs.declare import Array

LEVEL = 0.9
DRAWS = 9999
# Of lengths and angles: what scores of both are counted in, so that one mean is of all [mm, deg].
NOISE = {"mm": 1.0, "deg": 1.5}
Row = Mapping[str, Any]
Key = tuple[str, str]


def reach(degrees_of_freedom: float | None) -> float:
    """Half of a 90 % interval in standard deviations."""
    upper = 0.5 + 0.5 * LEVEL
    return float(ndtri(upper) if degrees_of_freedom is None else stdtrit(degrees_of_freedom, upper))


def scores(values: Sequence[Sequence[Any]], degrees_of_freedom: float | None) -> dict[Key, float]:
    """Interval score of each value that was predicted, by trial and coordinate, in the noise.

    The width of the interval, and 20 times how far beyond it the value is [1]_: low is good.

    References
    ----------
    .. [1] Gneiting and Raftery (2007), J. Am. Stat. Assoc. 102, 359-378,
           doi:10.1198/016214506000001437.
    """
    half = reach(degrees_of_freedom)
    made = {}
    for trial, coordinate, measured, predicted, *_, sd in values:
        if predicted is None or sd is None:
            continue
        beyond = max(abs(predicted - measured) - half * sd, 0.0)
        score = 2.0 * half * sd + 2.0 / (1.0 - LEVEL) * beyond
        made[trial, coordinate] = score / NOISE[coordinate.rpartition("_")[2]]
    return made


def within(values: Sequence[Sequence[Any]], degrees_of_freedom: float | None) -> float:
    """Share of the values predicted that lie in their intervals."""
    half = reach(degrees_of_freedom)
    inside = [
        abs(x[3] - x[2]) <= half * x[-1] for x in values if x[3] is not None and x[-1] is not None
    ]
    return float(np.mean(inside))


def rms(values: Sequence[Sequence[Any]], coordinate: str = "", begin: str = "") -> float:
    """Root-mean-square error of the values predicted, of one coordinate or kind of trial.

    NaN without any.
    """
    off = [
        x[3] - x[2]
        for x in values
        if x[3] is not None and coordinate in ("", x[1]) and x[0].startswith(begin)
    ]
    return float(np.sqrt(np.mean(np.square(off)))) if off else float("nan")


def difference(
    one: Mapping[Key, float], other: Mapping[Key, float], *, seed: int = 0
) -> tuple[float, float, float]:
    """Mean score of one less that of the other, with its 95 % interval by bootstrap over trials.

    Only values count that both predicted. Trials are drawn with all their values.
    """
    both = [x for x in one if x in other]
    trials = list(dict.fromkeys(trial for trial, _ in both))
    sums = np.array([sum(one[x] - other[x] for x in both if x[0] == t) for t in trials])
    counts = np.array([sum(x[0] == t for x in both) for t in trials])
    drawn = np.random.default_rng(seed).integers(len(trials), size=(DRAWS, len(trials)))
    means: Array = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(sums.sum() / counts.sum()), float(low), float(high)
