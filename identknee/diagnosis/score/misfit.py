"""What of residuals the fitted parameters cannot explain, and whether that looks like noise."""

from collections.abc import Sequence

import numpy as np
from scipy import stats
from scipy.special import gammaincc, gammaln, log_ndtr, ndtri_exp

from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import array, declared, entry

# Share of the largest singular value. Directions the data hardly see are kept on purpose: each
# costs one degree of freedom and makes every statistic indifferent to which near-equivalent fit was
# found.
LEAST_SINGULAR_VALUE = 1e-6
# Cauchy's combination cannot take a probability of 1.
MOST_PROBABLE = 0.99
# Where the incomplete gamma function is close to the smallest number, its expansion is exact
# enough.
LEAST_TAIL = 1e-280


@declared
class Projector:
    """The projection onto what the fitted parameters cannot explain."""

    basis: Array = array(
        "Orthonormal columns of what they can explain. The m rows are the whitened data, followed "
        "by the rows of the prior where there is one",
        "row",
        "direction",
    )

    @property
    def n_rows(self) -> int:
        """Rows, those of the prior included."""
        return len(self.basis)

    @property
    def rank(self) -> int:
        """How many directions are taken out."""
        return int(self.basis.shape[1])

    @property
    def degrees_of_freedom(self) -> int:
        """What is left for the residuals."""
        return self.n_rows - self.rank

    def padded(self, values: Array) -> Array:
        """`values` with rows of zeros for the prior where those rows are missing.

        Parameters
        ----------
        values
            Shape ``(m,)`` or ``(m, k)`` or, of the data rows alone, fewer rows.
        """
        missing = self.n_rows - len(values)
        return np.concatenate([values, np.zeros((missing, *values.shape[1:]))])

    def project(self, values: Array) -> Array:
        """What of `values` the fitted parameters cannot explain.

        Parameters
        ----------
        values
            As in `padded`.
        """
        rows = self.padded(values)
        projected: Array = rows - self.basis @ (self.basis.T @ rows)
        return projected

    def with_columns(self, columns: Array) -> "Projector":
        """The projector that takes out `columns` too, shape ``(m, k)`` as in `padded`."""
        # Twice, so that little is left of the basis also where little is left of a column.
        left = self.project(self.project(columns))
        new = _orthonormal(left, np.linalg.norm(columns, axis=0))
        return Projector(basis=np.hstack([self.basis, new]))


def base_projector(jacobian: Array) -> Projector:
    """The projector that belongs to a fit.

    Parameters
    ----------
    jacobian
        Derivatives of the whitened predictions by the fitted parameters, followed by the rows of
        their prior, ``[J; C0^(-1/2)]``, shape ``(m, p)``. Every direction is taken out whose
        singular value is more than 1e-6 of the largest, columns scaled to length 1.
    """
    nothing = Projector(basis=np.zeros((len(jacobian), 0)))
    return nothing.with_columns(jacobian)


def _orthonormal(columns: Array, sizes: Array) -> Array:
    """A basis of `columns`, each compared with the size it had before any projection."""
    seen = np.linalg.norm(columns, axis=0) > LEAST_SINGULAR_VALUE * sizes
    if not seen.any():
        return np.zeros((len(columns), 0))
    left, size, _ = np.linalg.svd(columns[:, seen] / sizes[seen], full_matrices=False)
    return np.asarray(left[:, size > LEAST_SINGULAR_VALUE * size[0]])


@declared
class Check:
    """One test of residuals."""

    statistic: float = entry("A chi-square, or an F ratio", unit="1")
    degrees_of_freedom: int = entry("Degrees of freedom of it, or of its numerator", unit="1")
    p_value: float = entry("Probability of one as large if the residuals are noise", unit="1")


def omnibus_check(
    residuals: Array, projector: Projector, *, noise_degrees: float = np.inf
) -> Check:
    """Whether the residuals are larger than noise.

    Parameters
    ----------
    residuals
        Whitened, rows of the prior included where the projector has them, shape ``(m,)``.
    projector
        Projector of the fit.
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
        Projector of the fit.
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
        Loads of each trial, shape ``(n, a)``, in any units.
    flexion
        Flexion of each trial, shape ``(n,)``.
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


def z_score_of_log_tail(log_tail: Array) -> Array:
    """The z-score that is exceeded with the same probability."""
    return np.asarray(-ndtri_exp(np.minimum(log_tail, 0.0)))


def log_tail_of_z_score(z_score: Array) -> Array:
    """The log probability that a standard normal variable exceeds `z_score`."""
    return np.asarray(log_ndtr(-z_score))
