"""Tail probabilities of sums of squares, in logarithms so that strong effects still compare."""

import numpy as np
from scipy.special import gammaincc, gammaln, log_ndtr, ndtri_exp

from identknee.runs.arrays import Array

# Where the incomplete gamma function is close to the smallest number, its expansion is exact
# enough.
LEAST_TAIL = 1e-280


def log_chi2_tail(value: Array, degrees: float) -> Array:
    """The log probability that a chi-square variable exceeds `value`.

    Parameters
    ----------
    value
        Any shape; 0 is returned below 0.
    degrees
        Degrees of freedom, > 0, not necessarily whole.
    """
    shape, half = degrees / 2, np.maximum(value, 0.0) / 2
    tail = gammaincc(shape, half)
    far = tail < LEAST_TAIL
    large = np.where(far, half, 1.0)
    # Abramowitz and Stegun (1964), 6.5.32.
    series = 1 + (shape - 1) / large * (1 + (shape - 2) / large)
    expansion = (shape - 1) * np.log(large) - large - gammaln(shape) + np.log(np.abs(series))
    return np.asarray(np.where(far, expansion, np.log(np.where(far, 1.0, tail))))


def log_weighted_tail(value: Array, weights: Array) -> Array:
    """The log probability that ``sum_i weights_i x_i^2``, x standard normal, exceeds `value`.

    A chi-square variable is shifted and scaled to the first three moments; exact where the weights
    are equal.

    Parameters
    ----------
    value
        Any shape.
    weights
        Not negative, at least one positive, shape ``(k,)``.

    References
    ----------
    J. P. Imhof, Computing the distribution of quadratic forms in normal variables, Biometrika 48
    (1961) 419-426, section 4, doi:10.1093/biomet/48.3-4.419.
    """
    mean, squares, cubes = (float(np.sum(weights**power)) for power in (1, 2, 3))
    degrees = squares**3 / cubes**2
    return log_chi2_tail((value - mean) * squares / cubes + degrees, degrees)


def deviate_of_log_tail(log_tail: Array) -> Array:
    """The standard normal deviate that is exceeded with the same probability."""
    return np.asarray(-ndtri_exp(np.minimum(log_tail, 0.0)))


def log_tail_of_deviate(deviate: Array) -> Array:
    """The log probability that a standard normal variable exceeds `deviate`."""
    return np.asarray(log_ndtr(-deviate))
