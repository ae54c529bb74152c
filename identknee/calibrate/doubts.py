"""Warnings about a fit: lack of fit, active bounds, starts that disagree."""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from identknee.calibrate.problem import typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, Severity
from identknee.runs.words import amount, either, label_without_unit, listed, unit_of

# A misfit that noise alone would leave less often than this is doubtful, and one that is so many
# times what noise leaves (three times its standard deviation) speaks of a mistake in the data.
IMPROBABLE, GROSS = 1e-3, 9.0
# Twice what simple laxity devices leave against a robot, about 1 mm and 2.5 deg.
MOST_MM, MOST_DEG = 2.0, 5.0
# Share of a parameter's range: this close to an end it lies on it.
AT_END = 1e-6
# Rise of the deviance: fits as good as one another at 95 %, and fits that are the same.
AS_GOOD, SAME = 3.84, 0.1
# Typical steps (3 kN, 2 %) between parameter sets that are not the same.
APART = 0.1
MISTAKES = "a sign, a unit or a side of the data may be wrong, or the model lacks something"


def misfit_findings(square: float, n_values: int, n_parameters: int) -> tuple[Finding, ...]:
    """Whether the residuals of a fit exceed the stated noise.

    Parameters
    ----------
    square
        Sum of the squared residuals in units of their noise; what it is where there is no
        prediction, inf, is not judged.
    n_values, n_parameters
        Values measured, and parameters fitted to them.
    """
    degrees = n_values - n_parameters
    if degrees < 1 or not np.isfinite(square) or chdtrc(degrees, square) >= IMPROBABLE:
        return ()
    ratio = square / degrees
    severity = Severity.ERROR if ratio > GROSS else Severity.WARNING
    sentence = (
        f"The best fit leaves {ratio:.3g} times the misfit that noise of the stated size would "
        f"(chi-square {square:.4g} with {degrees} degrees of freedom): {MISTAKES}, or the noise is "
        "larger, and nothing said here allows for that. See: identknee diagnose"
    )
    return (Finding(severity=severity, sentence=sentence, where="data"),)


def too_few_findings(n_values: int, n_parameters: int) -> tuple[Finding, ...]:
    """Whether fewer values were measured than parameters are fitted."""
    if n_values >= n_parameters:
        return ()
    values = "1 value was" if n_values == 1 else f"{n_values} values were"
    sentence = (
        f"Only {values} measured for {n_parameters} free parameters: many other parameter sets fit "
        "just as well. Measure more trials, or hold parameters with --fix."
    )
    return (Finding(severity=Severity.WARNING, sentence=sentence, where="data"),)


def unstated_misfit_findings(mm: float | None, deg: float | None) -> tuple[Finding, ...]:
    """Lack of fit where the data state no noise, against the largest expected errors.

    Parameters
    ----------
    mm, deg
        Root-mean-square of what the fit leaves; None or NaN where no such coordinate was measured.
    """
    sizes = [
        f"{size:.3g} {unit}"
        for size, unit, most in ((mm, "mm", MOST_MM), (deg, "deg", MOST_DEG))
        if size is not None and size > most
    ]
    if sizes:
        sentence = (
            f"The best fit leaves {' and '.join(sizes)}, more than a laxity test should err by "
            f"({MOST_MM:g} mm, {MOST_DEG:g} deg): {MISTAKES}. See: identknee diagnose"
        )
        return (Finding(severity=Severity.ERROR, sentence=sentence, where="data"),)
    sentence = (
        "The data state no noise, so whether the error left is noise alone could not be judged. "
        "Add sd_ columns to judge it."
    )
    return (Finding(severity=Severity.INFO, sentence=sentence, where="data"),)


def bound_findings(
    theta: Array, parameters: Parameters, fixed: Sequence[str] = ()
) -> tuple[Finding, ...]:
    """Which fitted parameters lie at an active bound, where the data do not determine them."""
    margin = AT_END * (parameters.upper - parameters.lower)
    standing = [
        f"{label_without_unit(name)} ({amount(end, unit_of(name))})"
        for name, value, low, high, near in zip(
            parameters.names, theta, parameters.lower, parameters.upper, margin, strict=True
        )
        for end in (low, high)
        if abs(value - end) <= near and name not in fixed and low < high
    ]
    if not standing:
        return ()
    many = "1 parameter stands" if len(standing) == 1 else f"{len(standing)} parameters stand"
    sentence = (
        f"{many} at a bound, where the bound stopped the fit and not the data: "
        f"{listed(standing)}. The other parameters compensate for it."
    )
    return (Finding(severity=Severity.WARNING, sentence=sentence, where="parameters"),)


def at_zero(theta: Array, parameters: Parameters) -> tuple[str, ...]:
    """Names of the parameters at a lower bound of zero, as of an absent structure."""
    zero = (theta <= 0.0) & (parameters.lower == 0.0)
    return tuple(x for x, is_zero in zip(parameters.names, zero, strict=True) if is_zero)


def start_findings(thetas: Array, deviances: Array, parameters: Parameters) -> tuple[Finding, ...]:
    """Whether fits from several starts agree.

    Parameters
    ----------
    thetas
        Where each fit ended, shape ``(k, p)``.
    deviances
        Sum of squared residuals there in units of their noise, inf without a prediction,
        shape ``(k,)``.
    parameters
        What was fitted.
    """
    k = len(deviances)
    if k < 2 or not np.isfinite(deviances).any():
        return ()
    best = int(np.argmin(deviances))
    rises = deviances - deviances[best]
    # Where starts leave a nuisance is no news.
    asked = parameters.is_of_interest
    away = np.max((np.abs(thetas - thetas[best]) / typical_steps(parameters))[:, asked], axis=1)
    rivals = np.flatnonzero((rises <= AS_GOOD) & (away > APART))
    if rivals.size:
        farthest = rivals[int(np.argmax(away[rivals]))]
        apart = listed(_changes(thetas[best], thetas[farthest], parameters))
        sentence = (
            f"Starts disagree: {rivals.size} of {k} ended at other parameters that fit as well at "
            f"95 % ({apart}; misfit higher by {rises[farthest]:.2g}). See: identknee profile"
        )
        return (Finding(severity=Severity.WARNING, sentence=sentence, where="starts"),)
    if np.count_nonzero(rises <= SAME) == 1:
        others = rises[np.isfinite(rises) & (rises > SAME)]
        next_best = f"the next best misfit is higher by {others.min():.3g}" if others.size else ""
        sentence = (
            f"Only one of {k} starts ended at the lowest misfit"
            + (f" ({next_best})" if next_best else " and no other had a prediction")
            + ": a lower one may exist. See: identknee sweep"
        )
        return (Finding(severity=Severity.WARNING, sentence=sentence, where="starts"),)
    return ()


def _changes(theta: Array, other: Array, parameters: Parameters) -> list[str]:
    """The two parameters that differ most in typical steps, with both values."""
    size = np.abs(other - theta) / typical_steps(parameters)
    asked = parameters.is_of_interest
    most = np.argsort(-np.where(asked, size, 0.0))[: min(2, int(asked.sum()))]
    return [either(parameters.names[i], theta[i], other[i]) for i in most]
