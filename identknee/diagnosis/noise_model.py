"""The covariance of measured laxity, and values in units in which its errors are independent."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.marginalise import marginal_covariance

# Standard deviations that a measurement in mm or deg may have; squares of these keep their digits.
SMALLEST, LARGEST = 1e-9, 1e6
# Values whitened at once; a table of up to a hundred trials is one block.
BLOCK = 500


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
    beside: Array | None = entry(
        "Change of f further values, in units of their own independent errors, by each nuisance, "
        "shape ``(f, k)``; None where there are none that have nuisances",
        default=None,
    )
    _blocks: tuple[_Block, ...] = field(init=False, repr=False)
    _conditional: tuple[Array, Array] | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_blocks", tuple(self._in_blocks()))
        conditional = None
        if self.beside is not None:
            # What whitened values say of the further ones, and what they leave unknown.
            carried = self.beside @ self.whiten(self.nuisances).T
            left = marginal_covariance(self.beside) - carried @ carried.T
            conditional = carried, np.asarray(np.linalg.cholesky(left))
        object.__setattr__(self, "_conditional", conditional)

    @property
    def n(self) -> int:
        """How many values there are."""
        return len(self.sd)

    @property
    def alone(self) -> "NoiseModel":
        """The values' own errors, without nuisances."""
        return replace(self, nuisances=self.nuisances[:, :0], further=None, beside=None)

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

    def whiten_beside(self, values: Array, whitened: Array) -> Array:
        """The further `values` (f,) or (f, k), given the others as `whiten` has them."""
        if self._conditional is None:
            return values
        carried, factor = self._conditional
        left = values - carried @ whitened
        return np.asarray(solve_triangular(factor, left, lower=True, check_finite=False))

    def of(self, rows: BoolArray) -> "NoiseModel":
        """The errors of some of the values alone, `rows` of shape ``(m,)``; no further ones."""
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
    beside: Array | None = None,
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
    beside
        What they change in f further values, in units of their own errors, shape ``(f, k)``.

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
            beside=None if beside is None or nuisance_sd is None else beside * nuisance_sd,
        )
    except np.linalg.LinAlgError:
        raise ValueError(
            f"the noise, {measured_sd.min():g} to {measured_sd.max():g}, cannot be "
            "distinguished from zero beside what the model does not know; state the noise of the "
            "measurement"
        ) from None
