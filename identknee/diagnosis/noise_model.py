"""The covariance of measured laxity, and values in units in which its errors are independent."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array

from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared, entry
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
# Values whitened at once; a table of up to a hundred trials is one block.
BLOCK = 500


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Block:
    """Some values in a row, and what those before them leave unknown of them."""

    rows: slice
    factor: Array  # lower Cholesky factor of their covariance, given the values before them
    learning: Array  # how their whitened errors move the mean of the nuisances


@declared
class NoiseModel:
    """Errors of the measured values: Gaussian with a known covariance.

    Its own error, which shares `correlation` with those of its trial alone, and nuisances that may
    be shared by all. The Cholesky factor of their sum is applied block by block: values are taken
    given those before them, of which only what they say of the nuisances counts. So memory and time
    grow with the number of values and not with its square.
    """

    trial: IntArray = array("The trial of each value, in its order", "value", dtype=int)
    sd: Array = array("Standard deviation of its own error, in its unit", "value")
    correlation: float = entry("Shared by the own errors of a trial", unit="1")
    nuisances: Array = array(
        "Change of each value by each independent nuisance of standard deviation 1",
        *("value", "nuisance"),
    )
    further: Array | None = entry(
        "Covariance of further errors, of all values, shape ``(m, m)``; None for none", default=None
    )
    _blocks: tuple[_Block, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_blocks", tuple(self._in_blocks()))

    @property
    def n(self) -> int:
        """How many values there are."""
        return len(self.sd)

    @property
    def alone(self) -> "NoiseModel":
        """The values' own errors, without nuisances."""
        return replace(self, nuisances=self.nuisances[:, :0], further=None)

    @property
    def covariance(self) -> Array:
        """Covariance of the values, in the units of the table, shape ``(m, m)``."""
        return self.between(np.arange(self.n), np.arange(self.n))

    @property
    def factor(self) -> Array:
        """Its lower Cholesky factor, shape ``(m, m)``."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    @property
    def scale(self) -> Array:
        """Diagonal of that factor, shape ``(m,)``."""
        return np.concatenate([np.diag(x.factor) for x in self._blocks])

    def between(self, rows: IntArray, others: IntArray) -> Array:
        """Covariance of some of the values with others, shape ``(len(rows), len(others))``."""
        whole = self._own(rows, others) + self.nuisances[rows] @ self.nuisances[others].T
        return whole if self.further is None else whole + self.further[np.ix_(rows, others)]

    def whiten(self, values: Array) -> Array:
        """`values` in units in which errors are independent with variance 1.

        Parameters
        ----------
        values
            One row for each measured value, shape ``(m,)`` or ``(m, k)``.
        """
        whitened = np.empty(values.shape)
        mean = np.zeros((self.nuisances.shape[1], *values.shape[1:]))
        for block in self._blocks:
            own = values[block.rows]
            if block.rows.start and len(mean):
                own = own - self.nuisances[block.rows] @ mean
            whitened[block.rows] = solve_triangular(
                block.factor, own, lower=True, check_finite=False
            )
            mean += block.learning @ whitened[block.rows]
        return whitened

    def of(self, rows: BoolArray) -> "NoiseModel":
        """The errors of some of the values alone, `rows` of shape ``(m,)``."""
        return NoiseModel(
            trial=self.trial[rows],
            sd=self.sd[rows],
            correlation=self.correlation,
            nuisances=self.nuisances[rows],
            further=None if self.further is None else self.further[np.ix_(rows, rows)],
        )

    def with_added_covariance(self, slopes: Array, prior: Array) -> "NoiseModel":
        """These errors and those of nuisances on top, see `identknee.runs.marginalise`.

        Parameters
        ----------
        slopes
            Change of each value with each nuisance, shape ``(m, e)``.
        prior
            Covariance of the nuisances, shape ``(e, e)``.
        """
        noise = np.zeros((self.n, self.n)) if self.further is None else self.further
        return replace(self, further=marginal_covariance(slopes, prior, noise=noise))

    def _own(self, rows: IntArray, others: IntArray) -> Array:
        """Covariance of own errors, shape ``(len(rows), len(others))``."""
        shared = np.where(self.trial[rows][:, None] == self.trial[others], self.correlation, 0.0)
        shared[rows[:, None] == others] = 1.0
        return np.asarray(self.sd[rows][:, None] * shared * self.sd[others])

    def _in_blocks(self) -> Iterator[_Block]:
        """The blocks, each of whole trials; one where there are few values, or further errors."""
        most = self.n if self.further is not None else BLOCK
        starts = [0]
        for first in np.flatnonzero(np.diff(self.trial, prepend=-1)).tolist():
            end = np.searchsorted(self.trial, self.trial[first], side="right")
            if end - starts[-1] > most and first > starts[-1]:
                starts.append(first)
        information = root = np.eye(self.nuisances.shape[1])
        for start, end in pairwise([*starts, self.n]):
            rows, places = slice(start, end), np.arange(start, end)
            own, slopes = self._own(places, places), self.nuisances[rows]
            # Of the nuisances, in units in which what the values before say leaves variance 1.
            left = solve_triangular(root, slopes.T, lower=True).T if start else slopes
            covariance = own + left @ left.T
            if self.further is not None:
                covariance = covariance + self.further
            factor = np.asarray(np.linalg.cholesky(covariance))
            known = solve_triangular(factor, left, lower=True)
            yield _Block(
                rows=rows,
                factor=factor,
                learning=solve_triangular(root, known.T, lower=True, trans="T"),
            )
            if end < self.n:
                seen = solve_triangular(np.linalg.cholesky(own), slopes, lower=True)
                information = information + seen.T @ seen
                root = np.linalg.cholesky(information)


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
    columns = np.zeros((measured_sd.size, 0))
    if nuisance is not None and nuisance_sd is not None:
        columns = nuisance * nuisance_sd
    try:
        return NoiseModel(
            trial=np.nonzero(is_measured)[0],
            sd=measured_sd,
            correlation=correlation,
            nuisances=columns,
        )
    except np.linalg.LinAlgError:
        raise ValueError(
            f"the noise, {measured_sd.min():g} to {measured_sd.max():g}, cannot be "
            "distinguished from zero beside what the model does not know; state the noise of the "
            "measurement"
        ) from None


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
        parts = [(np.zeros(0), np.zeros((2, 0), int))]
        for curve in curves:
            on = used[curve.trials]
            trials, load = curve.trials[on], curve.load[on]
            degree = min(CURVE_DEGREE, len(trials) - 1 - LEAST_LEFT)
            if degree >= 1:
                smooth, _ = np.linalg.qr(_powers(load, degree))
                rough = np.eye(len(trials)) - smooth @ smooth.T
                parts.append((rough.ravel(), np.stack(np.meshgrid(trials, trials)).reshape(2, -1)))
        left = _sparse(parts, len(used), len(used))
        if _degrees_of_freedom(left) < LEAST_DEGREES:
            continue
        pair = np.where(used[:, None], residuals[:, [first, second]], 0.0)
        products = pair.T @ (left @ pair)
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
        parts, n_rows = [(np.zeros(0), np.zeros((2, 0), int))], 0
        for curve in curves:
            on = used[curve.trials]
            trials, load = curve.trials[on], curve.load[on]
            for start in range(len(trials) - WINDOW + 1):
                window = slice(start, start + WINDOW)
                whole, _ = np.linalg.qr(_powers(load[window], WINDOW - 2), mode="complete")
                parts.append((whole[:, -1], np.stack([np.full(WINDOW, n_rows), trials[window]])))
                n_rows += 1
        contrasts = _sparse(parts, n_rows, len(used))
        degrees += _degrees_of_freedom(contrasts.T @ contrasts)
        found.append(contrasts @ np.where(used, values[:, column], 0.0))
    degrees *= QUANTILE_EFFICIENCY
    if degrees < LEAST_DEGREES:
        return None
    sd = float(np.quantile(np.abs(np.concatenate(found)), WITHIN_ONE_SD))
    return EstimatedScale(sd=sd, degrees_of_freedom=degrees)


def _sparse(parts: Sequence[tuple[Array, IntArray]], rows: int, columns: int) -> csr_array:
    """The sum of entries given with their places (2, k), shape ``(rows, columns)``."""
    values, places = zip(*parts, strict=True)
    return csr_array((np.concatenate(values), np.concatenate(places, axis=1)), (rows, columns))


def _degrees_of_freedom(left: csr_array) -> float:
    """Degrees of freedom of the quadratic form `left`, by its first two moments."""
    squares = float(np.sum(left.data**2))
    return float(left.diagonal().sum()) ** 2 / squares if squares > 0 else 0.0


def _powers(load: Array, degree: int) -> Array:
    """Powers of the load scaled to -1 to 1, shape ``(k, degree + 1)``."""
    middle, half = (load[-1] + load[0]) / 2, (load[-1] - load[0]) / 2
    return np.vander((load - middle) / half, degree + 1)
