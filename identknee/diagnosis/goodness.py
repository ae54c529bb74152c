"""Whether residuals look like noise: in size, and in smooth patterns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identknee.diagnosis.projection import Projector
from identknee.runs.arrays import Array, BoolArray

# Cauchy's combination cannot take a probability of 1.
MOST_PROBABLE = 0.99


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Check:
    """One test of residuals.

    Attributes
    ----------
    statistic
        A chi-square, an F ratio or a normal deviate.
    degrees_of_freedom
        What a chi-square or the numerator of an F ratio has; 1 for a normal deviate.
    p_value
        Probability of a statistic as large if the residuals are noise.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float


def omnibus_check(
    residuals: Array, projector: Projector, *, noise_degrees: float = np.inf
) -> Check:
    """Whether the residuals are larger than noise.

    Parameters
    ----------
    residuals
        Whitened, rows of the prior included where the projector has them, shape ``(m,)``.
    projector
        Of the fit.
    noise_degrees
        Degrees of freedom of the noise's standard deviation where that is an estimate.
    """
    projected = projector.project(residuals)
    degrees = projector.degrees_of_freedom
    return size_check(float(projected @ projected), degrees, noise_degrees)


def nested_check(
    residuals: Array,
    projector: Projector,
    wider: Projector,
    *,
    noise_degrees: float = np.inf,
) -> Check:
    """Whether the residuals hold more of certain patterns than noise does.

    Parameters
    ----------
    residuals
        As in `omnibus_check`.
    projector
        Of the fit.
    wider
        The same with the whitened patterns taken out too, ``projector.with_columns(patterns)``:
        `smooth_patterns` for smooth misfit of any kind.
    noise_degrees
        As in `omnibus_check`.

    Raises
    ------
    ValueError
        If the fitted parameters explain every pattern.

    References
    ----------
    J. Neyman, "Smooth test" for goodness of fit, Scand. Actuar. J. (1937) 149-199,
    doi:10.1080/03461238.1937.10404821.
    """
    rank = wider.rank - projector.rank
    if rank == 0:
        raise ValueError("the fitted parameters explain every pattern; nothing is left to test")
    whole, left = projector.project(residuals), wider.project(residuals)
    squares_left = float(left @ left)
    square = float(whole @ whole) - squares_left
    return size_check(square, rank, noise_degrees)


def smooth_patterns(loads: Array, flexion: Array, is_measured: BoolArray) -> Array:
    """Patterns smooth in load and flexion, for each coordinate, not whitened, shape ``(m, k)``.

    Along each kind of load ``m, |m|, m^2, sgn m`` and whether there is any, times powers of the
    flexion up to its square, so that also misfit nobody listed is seen.

    Parameters
    ----------
    loads
        Of each trial, shape ``(n, a)``, in any units.
    flexion
        Of each trial, shape ``(n,)``.
    is_measured
        Which values there are, shape ``(n, 5)``; the m measured ones are taken row by row.
    """
    along = [np.ones(len(loads))]
    for load in loads.T[np.any(loads != 0, axis=0)]:
        scaled = load / np.abs(load).max()
        along += [scaled, np.abs(scaled), scaled**2, np.sign(load), np.sign(load) ** 2]
    middle = (flexion.max() + flexion.min()) / 2
    half = max(float(np.ptp(flexion)) / 2, np.finfo(np.float64).tiny)
    powers = np.vander((flexion - middle) / half, min(len(np.unique(flexion)), 3))
    trials = np.einsum("na,np->nap", np.stack(along, axis=1), powers).reshape(len(loads), -1)
    return _for_each_coordinate(trials, is_measured)


def cauchy_combination(p_values: Sequence[float]) -> float:
    """One probability from several that may depend on one another.

    References
    ----------
    Y. Liu and J. Xie, Cauchy combination test, J. Am. Stat. Assoc. 115 (2020) 393-402,
    doi:10.1080/01621459.2018.1554485.

    Examples
    --------
    >>> round(cauchy_combination([0.001, 0.5]), 4)
    0.002
    """
    used = np.clip(p_values, np.finfo(np.float64).tiny, MOST_PROBABLE)
    # The upper tail by the cotangent, exact also where probabilities are tiny.
    mean = float(np.mean(1 / np.tan(np.pi * used)))
    return float(np.arctan2(1.0, mean) / np.pi)


def size_check(square: float, degrees: int, noise_degrees: float) -> Check:
    """Whether a sum of squares is larger than noise: chi-square, or F for an estimated noise."""
    if np.isinf(noise_degrees):
        p_value = float(stats.chi2.sf(square, degrees))
        return Check(statistic=square, degrees_of_freedom=degrees, p_value=p_value)
    ratio = square / degrees
    p_value = float(stats.f.sf(ratio, degrees, noise_degrees))
    return Check(statistic=ratio, degrees_of_freedom=degrees, p_value=p_value)


def _for_each_coordinate(trials: Array, is_measured: BoolArray) -> Array:
    """Patterns of trials, shape ``(n, k)``, in each coordinate alone, measured rows only."""
    n_coordinates = is_measured.shape[1]
    whole = np.einsum("nk,ij->nijk", trials, np.eye(n_coordinates))
    rows = np.asarray(whole[is_measured]).reshape(int(is_measured.sum()), -1)
    return np.asarray(rows[:, rows.any(axis=0)])
