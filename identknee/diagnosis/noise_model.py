"""The covariance of measured laxity, and values in units in which its errors are independent."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import solve_triangular

from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared
from identknee.runs.marginalise import marginal_covariance

# Degree of the polynomial that is removed along a load curve; the residuals are the noise.
CURVE_DEGREE = 4
# Degrees of freedom that a polynomial must leave, or the curve is not used.
LEAST_LEFT = 2
# Degrees of freedom in all below which a correlation or a standard deviation is not estimated.
LEAST_DEGREES = 8.0
# Consecutive points whose deviation from a cubic is one look at the noise.
WINDOW = 5
# Share of normal errors within one standard deviation, and the efficiency of that quantile.
WITHIN_ONE_SD, QUANTILE_EFFICIENCY = 0.6827, 0.54
# Standard deviations that a measurement in mm or deg may have; squares of these keep their digits.
SMALLEST, LARGEST = 1e-9, 1e6
# A covariance beyond these is singular or nearly so, whatever the estimate says.
LEAST_CORRELATION, MOST_CORRELATION = -0.2, 0.95


@declared
class Curve:
    """Trials of one flexion angle that differ in one load, in the order of that load.

    Raises
    ------
    ValueError
        If the loads do not increase or are not one for each trial.
    """

    trials: IntArray = array(
        "Rows of the table. A trial without load may be on several curves", "trial", dtype=int
    )
    load: Array = array("The load of each, increasing, in any unit", "trial")

    def __post_init__(self) -> None:
        if np.any(np.diff(self.load) <= 0):
            raise ValueError("the loads of a curve must increase; sort its trials, one for a load")


@declared
class NoiseModel:
    """Errors of the measured values: Gaussian with a known covariance."""

    covariance: Array = array(
        "Covariance of the measured values, in the units of the table", "value", "value"
    )
    factor: Array = array("Its lower Cholesky factor", "value", "value")

    def whiten(self, values: Array) -> Array:
        """`values` in units in which errors are independent with variance 1.

        Parameters
        ----------
        values
            One row for each measured value, shape ``(m,)`` or ``(m, k)``.
        """
        whitened: Array = solve_triangular(self.factor, values, lower=True, check_finite=False)
        return whitened

    def of(self, rows: BoolArray) -> "NoiseModel":
        """The errors of some of the values alone, `rows` of shape ``(m,)``."""
        return _noise_model(self.covariance[np.ix_(rows, rows)])

    def with_added_covariance(self, slopes: Array, prior: Array | None = None) -> "NoiseModel":
        """These errors and those of nuisances on top, see `identknee.runs.marginalise`.

        Parameters
        ----------
        slopes
            Change of each value with each nuisance, shape ``(m, e)``.
        prior
            Covariance of the nuisances, shape ``(e, e)``; the identity if None.
        """
        return _noise_model(marginal_covariance(slopes, prior, noise=self.covariance))


def build_noise_model(
    sd: Array,
    is_measured: BoolArray,
    *,
    correlation: float,
    nuisance: Array | None = None,
    nuisance_sd: Array | None = None,
) -> NoiseModel:
    """The covariance of the measured values: noise, and what declared nuisances add to it.

    The five errors of a trial share `correlation`, trials are independent. A nuisance is a cause of
    misfit that nobody wants named: its columns are the change of the measured values for a change
    of 1, and their product with its spread joins the covariance, ``noise + G diag(sd^2) G'``, which
    is to average over the nuisance with a Gaussian prior.

    Parameters
    ----------
    sd
        Standard deviation of each value in its unit, shape ``(n, 5)``; read where measured.
    is_measured
        Which values there are, shape ``(n, 5)``; the m measured ones are taken row by row.
    correlation
        Shared by the errors of a trial, above -0.25 and below 1.
    nuisance
        Columns of nuisances, shape ``(m, k)``.
    nuisance_sd
        Prior standard deviation of each, shape ``(k,)``.

    Raises
    ------
    ValueError
        If a standard deviation is not positive or too small for the digits of the computer, or the
        correlation is out of range.
    """
    if not -0.25 < correlation < 1.0:
        raise ValueError(f"correlation must lie between -0.25 and 1, got {correlation:g}")
    measured_sd = sd[is_measured]
    if not np.all((measured_sd > 0) & np.isfinite(measured_sd)):
        raise ValueError("every measured value needs a standard deviation greater than 0")
    if measured_sd.size and (measured_sd.min() < SMALLEST or measured_sd.max() > LARGEST):
        raise ValueError(
            f"the noise is {measured_sd.min():g} to {measured_sd.max():g}, which no measurement in "
            "mm or deg has; state that of the measurement"
        )
    trial = np.nonzero(is_measured)[0]
    shared = np.where(trial[:, None] == trial, correlation, 0.0)
    np.fill_diagonal(shared, 1.0)
    covariance = measured_sd[:, None] * shared * measured_sd
    if nuisance is not None and nuisance_sd is not None:
        covariance = marginal_covariance(nuisance * nuisance_sd, noise=covariance)
    try:
        return _noise_model(covariance)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"the noise, {measured_sd.min():g} to {measured_sd.max():g}, cannot be "
            "distinguished from zero beside what the model does not know; state the noise of the "
            "measurement"
        ) from None


def _noise_model(covariance: Array) -> NoiseModel:
    return NoiseModel(covariance=covariance, factor=np.asarray(np.linalg.cholesky(covariance)))


def estimate_correlation(
    residuals: Array, is_measured: BoolArray, curves: Sequence[Curve]
) -> float | None:
    """The correlation that the errors of a trial share, or None where the data are too few.

    A quartic is removed along every load curve, so that smooth misfit does not pass for noise; on
    short curves the degree is lower. What is left is correlated between coordinates, averaged over
    all pairs.

    Parameters
    ----------
    residuals
        Measured less predicted, in units of the stated standard deviations (or with one standard
        deviation a coordinate), shape ``(n, 5)``; read where measured.
    is_measured
        Which values there are, shape ``(n, 5)``.
    curves
        The load curves of the protocol.
    """
    found = []
    for first, second in combinations(range(residuals.shape[1]), 2):
        used = is_measured[:, first] & is_measured[:, second]
        # The sum over curves of the projections that remove a polynomial, shape ``(n, n)``.
        left = np.zeros((len(used), len(used)))
        for curve in curves:
            on = used[curve.trials]
            trials, load = curve.trials[on], curve.load[on]
            degree = min(CURVE_DEGREE, len(trials) - 1 - LEAST_LEFT)
            if degree >= 1:
                smooth, _ = np.linalg.qr(_powers(load, degree))
                left[np.ix_(trials, trials)] += np.eye(len(trials)) - smooth @ smooth.T
        if _degrees_of_freedom(left) < LEAST_DEGREES:
            continue
        pair = np.where(used[:, None], residuals[:, [first, second]], 0.0)
        products = pair.T @ left @ pair
        size = np.sqrt(products[0, 0] * products[1, 1])
        if size > 0:
            found.append(products[0, 1] / size)
    if not found:
        return None
    return float(np.clip(np.mean(found), LEAST_CORRELATION, MOST_CORRELATION))


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedScale:
    """The size of the noise as the roughness of load curves shows it.

    Attributes
    ----------
    sd
        Standard deviation, in the unit of the values.
    degrees_of_freedom
        What the estimate is worth.
    """

    sd: float
    degrees_of_freedom: float


def estimate_scale(
    values: Array, is_measured: BoolArray, curves: Sequence[Curve]
) -> EstimatedScale | None:
    """The common noise of some columns from how their curves deviate from a cubic on five points.

    The pure error of data without replicates. Kinks of a curve and outliers must not count as
    noise: what 68 % of the deviations stay below is one standard deviation, however large the
    others are. None where there are too few points.

    Parameters
    ----------
    values
        Measured less predicted, or the measured values, in units of their noise up to one common
        factor, shape ``(n, k)``; read where measured.
    is_measured
        Which values there are, shape ``(n, k)``.
    curves
        The load curves of the protocol.

    References
    ----------
    T. Gasser, L. Sroka and C. Jennen-Steinmetz, Residual variance and residual pattern in nonlinear
    regression, Biometrika 73 (1986) 625-633, doi:10.1093/biomet/73.3.625.
    """
    found, degrees = [], 0.0
    for column in range(values.shape[1]):
        used = is_measured[:, column]
        # Contrasts of five consecutive points that a cubic leaves at zero, a row each, ``(c, n)``.
        rows = [np.zeros((0, len(used)))]
        for curve in curves:
            on = used[curve.trials]
            trials, load = curve.trials[on], curve.load[on]
            for start in range(len(trials) - WINDOW + 1):
                window = slice(start, start + WINDOW)
                whole, _ = np.linalg.qr(_powers(load[window], WINDOW - 2), mode="complete")
                row = np.zeros((1, len(used)))
                row[0, trials[window]] = whole[:, -1]
                rows.append(row)
        contrasts = np.concatenate(rows)
        degrees += _degrees_of_freedom(contrasts.T @ contrasts)
        found.append(contrasts @ np.where(used, values[:, column], 0.0))
    degrees *= QUANTILE_EFFICIENCY
    if degrees < LEAST_DEGREES:
        return None
    sd = float(np.quantile(np.abs(np.concatenate(found)), WITHIN_ONE_SD))
    return EstimatedScale(sd=sd, degrees_of_freedom=degrees)


def _degrees_of_freedom(left: Array) -> float:
    """Degrees of freedom of the quadratic form `left`, by its first two moments."""
    squares = float(np.sum(left**2))
    return float(np.trace(left)) ** 2 / squares if squares > 0 else 0.0


def _powers(load: Array, degree: int) -> Array:
    """Powers of the load scaled to -1 to 1, shape ``(k, degree + 1)``."""
    middle, half = (load[-1] + load[0]) / 2, (load[-1] - load[0]) / 2
    return np.vander((load - middle) / half, degree + 1)
