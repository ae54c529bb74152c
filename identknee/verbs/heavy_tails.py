"""A fit whose errors have heavy tails, and what it says of single values."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from identknee.calibrate.fit import Fit
from identknee.calibrate.problem import Problem
from identknee.calibrate.student import DEGREES, fit_student, student_scales
from identknee.checks.usable_trials import residuals_of
from identknee.laxity.table import COORDINATES, Laxity
from identknee.runs.arrays import Array

# Of values with a weight below this so many are named.
LIGHT, MOST_LISTED = 0.5, 6


def robust(plain: Callable[..., Fit], problem: Problem, start: Array, fixed: Sequence[str]) -> Fit:
    """A fit whose errors have heavy tails."""
    return fit_student(problem, residuals_of(problem).units, start, partial(plain, fixed=fixed))


def about_tails(problem: Problem, laxity: Laxity, found: Fit) -> tuple[str, ...]:
    """The scales of errors with heavy tails, and the values that count least."""
    if not np.isfinite(found.objective):
        return ()
    data = residuals_of(problem)
    scales, weights = student_scales(data, data.units, found.theta)
    units = ("mm", "deg") if data.weighting == "unit" else ("sd of lengths", "sd of angles")
    shown = " and ".join(
        f"{scales[k]:.2g} {unit}" for k, unit in enumerate(units) if np.any(data.units == k)
    )
    trials, coordinates = np.nonzero(laxity.is_measured)
    light = [k for k in np.argsort(weights)[:MOST_LISTED].tolist() if weights[k] < LIGHT]
    least = ", ".join(
        f"{COORDINATES[coordinates[k]].rpartition('_')[0].replace('_', ' ')} of "
        f"{laxity.protocol.trials[trials[k]]} ({weights[k]:.2f})"
        for k in light
    )
    counted = f" Values counted least, with their weights: {least}." if least else ""
    sentence = (
        f"Errors were taken as Student's t with {DEGREES:.0f} degrees of freedom and a scale of "
        f"{shown}, estimated with the parameters.{counted}"
    )
    return (sentence,)
