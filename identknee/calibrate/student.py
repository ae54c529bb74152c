"""A robust fit: errors have heavy tails, and their size is estimated with the parameters."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from identknee.calibrate.fit import Fit
from identknee.calibrate.problem import (
    RANK_TOLERANCE,
    Problem,
    WhitenedResiduals,
    with_nuisance_priors,
    without_priors,
)
from identknee.runs.arrays import Array, IntArray

# Of Student's t: tails heavy enough that a gross error in twenty values moves next to nothing.
DEGREES = 4.0
MOST_FITS = 20
ROUNDS = 50
SETTLED = 1e-3
SMALLEST = 1e-9


def fit_student(
    problem: Problem, units: IntArray, start: Array, search: Callable[[Problem, Array], Fit]
) -> Fit:
    """The maximum-likelihood fit for Student's t errors of unknown scale.

    Least squares again and again, each value weighted by what the fit before left of it, until no
    scale changes by a thousandth. Nuisances keep their priors.

    Parameters
    ----------
    problem
        Its residuals in plain or in units of their noise, with rows for priors of nuisances.
    units
        The unit of each residual of the data, 0 or 1, shape ``(m,)``; each has a scale of its own.
    start
        Where the first fit begins, shape ``(n,)``.
    search
        A fit of a problem from a start.

    Returns
    -------
    fit
        The last fit, with the simulations of all; its objective is in units of the scales.

    References
    ----------
    .. [1] Lange, Little and Taylor (1989), J. Am. Stat. Assoc. 84(408), 881-896.
           https://doi.org/10.1080/01621459.1989.10478852
    """
    data, begun = without_priors(problem), np.array(start)
    found = search(problem, begun)
    n_simulations = found.n_simulations
    scales = np.zeros(2)
    for _ in range(MOST_FITS):
        if not np.isfinite(found.objective) or n_simulations >= found.budget:
            break
        before = scales
        scales, weights = student_scales(data, units, found.theta)
        if np.all(np.abs(scales - before) <= SETTLED * scales):
            break
        scaled = WhitenedResiduals(problem=data, sd=scales[units] / np.sqrt(weights))
        found = search(with_nuisance_priors(scaled), found.theta)
        n_simulations += found.n_simulations
    return replace(found, start=begun, n_simulations=n_simulations)


def student_scales(data: Problem, units: IntArray, theta: Array) -> tuple[Array, Array]:
    """The scale of each unit's errors (2,), and the weight of each value (m,).

    A scale is what the parameters leave of the weighted residuals, over the degrees of freedom that
    they leave; 1 where nothing has that unit.

    Parameters
    ----------
    data
        The residuals of the data alone.
    units
        As in `fit_student`.
    theta
        A fit, shape ``(n,)``.
    """
    residuals, is_there = data.residuals(theta), np.bincount(units, minlength=2) > 0
    scales, weights = np.ones(2), np.ones(units.size)
    for _ in range(ROUNDS):
        before = scales
        scaled = WhitenedResiduals(problem=data, sd=scales[units] / np.sqrt(weights))
        degrees = _residual_degrees_of_freedom(with_nuisance_priors(scaled).jacobian(theta), units)
        squares = np.bincount(units, weights=weights * residuals**2, minlength=2)
        scales = np.where(is_there, np.maximum(np.sqrt(squares / degrees), SMALLEST), 1.0)
        weights = (DEGREES + 1.0) / (DEGREES + (residuals / scales[units]) ** 2)
        if np.all(np.abs(scales - before) <= SETTLED * scales):
            break
    return scales, weights


def _residual_degrees_of_freedom(jacobian: Array, units: IntArray) -> Array:
    """Residual degrees of freedom of the values of each unit, at least 1."""
    left, size, _ = np.linalg.svd(jacobian, full_matrices=False)
    leverage = np.sum(left[: units.size, size > size[0] * RANK_TOLERANCE] ** 2, axis=1)
    return np.maximum(np.bincount(units, weights=1.0 - leverage, minlength=2), 1.0)
