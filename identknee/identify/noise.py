"""Noise of unknown size: one standard deviation for each group of residuals, from the fit."""

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import (
    RANK_TOLERANCE,
    Problem,
    WhitenedResiduals,
    with_nuisance_priors,
)
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry

TOLERANCE = 1e-10
MAX_ROUNDS = 50
# Largest residual that cannot be told from rounding.
SMALLEST_SD = 1e-9


@declared
class EstimatedNoise:
    """A problem with the noise estimated from its residuals."""

    problem: Problem = entry("The problem, its residuals in units of that noise")
    sds: Array = array("Standard deviation of each group, in the units of the data", "group")
    degrees_of_freedom: int = entry(
        "Residuals less parameters they determine: the denominator of an F threshold"
    )
    theta: Array = array("The best fit", "parameter")


def with_estimated_noise(problem: Problem, groups: IntArray, start: Array) -> EstimatedNoise:
    """The problem in units of its noise, estimated from the residuals of the best fit.

    The weighted fit and the standard deviations are repeated until neither changes. Each group's
    variance is its sum of squares over its own degrees of freedom: its residuals less its share of
    the fitted parameters, which is the trace of its block of the projection on the Jacobian.

    Parameters
    ----------
    problem
        Problem whose residuals are in the units of the data.
    groups
        The group of each residual, 0 to k - 1, shape ``(m,)``.
    start
        Where the fit begins, shape ``(n,)``.

    Raises
    ------
    ValueError
        If a group has no more residuals than the parameters it determines, if the fit leaves
        nothing to estimate a noise from, or if the model has no prediction at the start.

    References
    ----------
    H. D. Patterson and R. Thompson, Recovery of inter-block information when block sizes are
    unequal, Biometrika 58 (1971) 545-554, doi:10.1093/biomet/58.3.545.
    """
    sizes = np.bincount(groups)
    sds = np.ones(len(sizes))
    theta = np.asarray(start, dtype=np.float64)
    for _ in range(MAX_ROUNDS):
        scaled = with_nuisance_priors(WhitenedResiduals(problem=problem, sd=sds[groups]))
        best = fit(scaled, theta)
        if not np.isfinite(best.objective):
            raise ValueError(
                "the noise cannot be estimated because the model has no prediction at the start; "
                "start elsewhere with --start, or see: identknee subject check"
            )
        theta = best.theta
        shares = _parameters_determined(scaled.jacobian(theta), groups)
        new = _sds(problem.residuals(theta), groups, sizes - shares)
        settled = bool(np.all(np.abs(new - sds) <= TOLERANCE * new))
        sds = new
        if settled:
            break
    return EstimatedNoise(
        problem=with_nuisance_priors(WhitenedResiduals(problem=problem, sd=sds[groups])),
        sds=sds,
        degrees_of_freedom=round(float(sizes.sum() - shares.sum())),
        theta=theta,
    )


def _sds(residuals: Array, groups: IntArray, degrees: Array) -> Array:
    """Standard deviation of each group from its sum of squares and degrees of freedom."""
    if np.any(degrees < 1.0):
        raise ValueError(
            "there are too few measured values to estimate their noise beside the parameters; "
            "state it in the columns sd_<coordinate> or with --noise, for example "
            "--noise 0.5mm,0.5deg, measure more or fix parameters"
        )
    sds = np.sqrt(np.bincount(groups, weights=residuals**2) / degrees)
    if np.any(sds < SMALLEST_SD):
        raise ValueError(
            "the model fits the data exactly, so there is no noise to estimate; state it in the "
            "columns sd_<coordinate> or with --noise, for example --noise 0.5mm,0.5deg"
        )
    return np.asarray(sds)


def _parameters_determined(jacobian: Array, groups: IntArray) -> Array:
    """How many parameters each group determines, shape ``(k,)``.

    Rows of priors follow those of the groups: what they determine the data do not.
    """
    left, size, _ = np.linalg.svd(jacobian, full_matrices=False)
    rank = int(np.sum(size > size[0] * RANK_TOLERANCE))
    leverage = np.sum(left[:, :rank] ** 2, axis=1)
    shares = np.bincount(groups, weights=leverage[: len(groups)])
    return shares.astype(np.float64)
