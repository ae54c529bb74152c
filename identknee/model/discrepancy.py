"""What a model gets wrong, smooth in flexion and load: its size, and its share of the errors.

A Gaussian process in each coordinate whose standard deviations and correlation lengths are those
of highest marginal likelihood, with everything taken out that a change of the fitted parameters
could do. Parameters that are fitted while it is marginalised have intervals that allow for
a model that is wrong, but only as far as the error is smooth and of the size stated [1]_.

References
----------
.. [1] M. C. Kennedy and A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63
       (2001) 425-464, doi:10.1111/1467-9868.00294; M. Plumlee, Bayesian calibration of inexact
       computer models, J. Am. Stat. Assoc. 112 (2017) 1274-1285,
       doi:10.1080/01621459.2016.1211016; J. Brynjarsdottir and A. O'Hagan, Learning about physical
       parameters: the importance of model discrepancy, Inverse Problems 30 (2014) 114007,
       doi:10.1088/0266-5611/30/11/114007.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve
from scipy.optimize import minimize

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array, IntArray, array, declared, entry
from identknee.runs.words import amount, label_without_unit, unit_of

# Bounds of a correlation length, where flexion and each load vary between 0 and 1, or -1 and 1.
LEAST_LENGTH, MOST_LENGTH = 0.4, 5.0
START_LENGTH = 0.7
MOST_ITERATIONS = 30
# Bounds of a standard deviation, in units of its scale, and where the search for it begins.
LEAST_SPREAD, MOST_SPREAD, START_SPREAD = 1e-3, 1e2, 0.5
# Share of the largest eigenvalue of a covariance that is lost in rounding.
ROUNDING = 1e-9


class FittedKernel(NamedTuple):
    """Standard deviations and correlation lengths of highest marginal likelihood."""

    logs: Array
    """Logarithms of both, as `SmoothKernel.covariance` takes them."""
    spread: Array
    """Standard deviation in each measured coordinate, in units of the values' scale."""
    flexion_length: float
    """Correlation length over the range of flexion."""
    load_length: float
    """Correlation length over the largest load."""


class SmoothKernel:
    """Squared-exponential covariances of measured values, and their marginal likelihood.

    Parameters
    ----------
    protocol
        The trials.
    trial, coordinate
        Those of each value, shape ``(m,)``.
    scale
        Unit in which the standard deviation of each value counts, shape ``(m,)``.
    reduce
        The matrix that turns values into rows in units of their noise, off the parameters that are
        fitted, shape ``(r, m)``.
    """

    def __init__(
        self, protocol: Protocol, trial: IntArray, coordinate: IntArray, scale: Array, reduce: Array
    ) -> None:
        flexion = protocol.flexion_deg[trial] / max(float(np.ptp(protocol.flexion_deg)), 1.0)
        largest = np.abs(protocol.loads).max(axis=0)
        loads = (protocol.loads / np.where(largest > 0, largest, 1.0))[trial]
        self._flexion = (flexion[:, None] - flexion) ** 2
        self._load = ((loads[:, None] - loads) ** 2).sum(axis=2)
        self._pairs = np.outer(scale, scale)
        coordinates = np.unique(coordinate)
        self._own = coordinate[:, None] == coordinates
        self.n_coordinates = len(coordinates)
        self._reduce = reduce

    def covariance(self, logs: Array) -> Array:
        """Covariance of the values, before projection, shape ``(m, m)``."""
        shape = -0.5 * self._flexion * np.exp(-2 * logs[-2])
        shape = shape - 0.5 * self._load * np.exp(-2 * logs[-1])
        spread = self._own * np.exp(logs[:-2])
        return np.asarray(self._pairs * np.exp(shape) * (spread @ spread.T))

    def projected(self, covariance: Array) -> Array:
        """Covariance of the rows, projected off the fitted parameters, shape ``(r, r)``."""
        return np.asarray(self._reduce @ covariance @ self._reduce.T)

    def misfit(self, logs: Array, target: Array) -> tuple[float, Array]:
        """Minus the log marginal likelihood of the projected residuals, and its derivatives."""
        covariance = self.covariance(logs)
        factor = np.linalg.cholesky(np.eye(len(target)) + self.projected(covariance))
        inverse = cho_solve((factor, True), np.eye(len(target)))
        solved = inverse @ target
        value = 0.5 * target @ solved + np.log(np.diag(factor)).sum()
        weight = self._reduce.T @ (inverse - np.outer(solved, solved)) @ self._reduce
        terms = 0.5 * weight * covariance
        by_coordinate = self._own.T @ terms.sum(axis=1)
        gradient = np.r_[
            2.0 * by_coordinate,
            np.sum(terms * self._flexion) * np.exp(-2 * logs[-2]),
            np.sum(terms * self._load) * np.exp(-2 * logs[-1]),
        ]
        return float(value), gradient

    def fitted(
        self,
        target: Array,
        *,
        start: float,
        spreads: tuple[float, float],
        prior_sd: float = np.inf,
    ) -> FittedKernel:
        """The standard deviations and lengths of highest marginal likelihood.

        Parameters
        ----------
        target
            Projected residuals, shape ``(r,)``.
        start, spreads
            Where the search for the standard deviations begins, and their bounds.
        prior_sd
            Scale of a half-normal prior of each standard deviation; none if infinite.
        """

        def objective(logs: Array) -> tuple[float, Array]:
            value, gradient = self.misfit(logs, target)
            squares = np.exp(2.0 * logs[:-2]) / prior_sd**2
            return value + 0.5 * float(squares.sum()), gradient + np.r_[squares, 0.0, 0.0]

        begin = np.log(np.r_[np.full(self.n_coordinates, start), 2 * [START_LENGTH]])
        lengths = (LEAST_LENGTH, MOST_LENGTH)
        found = minimize(
            objective,
            begin,
            jac=True,
            method="L-BFGS-B",
            bounds=np.log([*[spreads] * self.n_coordinates, lengths, lengths]),
            options={"maxiter": MOST_ITERATIONS, "ftol": 1e-6},
        )
        values = np.exp(found.x)
        return FittedKernel(found.x, values[:-2], float(values[-2]), float(values[-1]))


@declared
class SmoothDiscrepancy:
    """A smooth error of a model in each coordinate of the trials that it was fitted to."""

    sd: Array = array(
        "Standard deviation in each coordinate [mm, deg]; 0 in one that was not measured",
        "coordinate",
    )
    flexion_length: float = entry("Correlation length over the range of flexion", unit="1")
    load_length: float = entry("Correlation length over the largest load", unit="1")
    columns: Array = entry(
        "Change of the coordinates by errors of one standard deviation, shape ``(n, 5, k)``"
    )

    @property
    def words(self) -> str:
        """Its size by coordinate, such as ``anterior_drawer_mm 0.4, varus_deg 1.2``."""
        sizes = zip(COORDINATES, self.sd, strict=True)
        return ", ".join(f"{name} {sd:.2g}" for name, sd in sizes if sd > 0.0)

    @property
    def sentence(self) -> str:
        """What was marginalised."""
        sizes = [
            f"{label_without_unit(name)} {amount(sd, unit_of(name), 2)}"
            for name, sd in zip(COORDINATES, self.sd.tolist(), strict=True)
            if sd > 0.0
        ]
        return (
            f"A smooth error of the model was marginalised: {', '.join(sizes)} (standard "
            "deviations that the data show). Intervals allow for it, but no name is given to it."
        )


def smooth_discrepancy(
    compared: LaxityResiduals, rows: Array, jacobian: Array, scales: tuple[float, float]
) -> SmoothDiscrepancy:
    """The smooth error of a model at its fit.

    Parameters
    ----------
    compared
        Model and data, in units of their noise, without such an error.
    rows
        Residuals at the fit, those of `compared` first, shape ``(r,)``.
    jacobian
        Change of the rows with the parameters fitted, shape ``(r, p)``.
    scales
        Standard deviations of lengths and of angles [mm, deg] that are scales of half-normal
        priors of what is found.
    """
    laxity = compared.laxity
    trial, coordinate = np.nonzero(laxity.is_measured)
    m = trial.size
    single = np.zeros((*laxity.coordinates.shape, m))
    single[trial, coordinate, np.arange(m)] = 1.0
    whitened = np.zeros((len(rows), m))
    whitened[:m] = compared.rows(single)
    left, size, _ = np.linalg.svd(jacobian, full_matrices=False)
    basis = left[:, size > size[0] * ROUNDING]
    scale = np.array([scales[int(x.endswith("_deg"))] for x in COORDINATES])
    kernel = SmoothKernel(
        laxity.protocol,
        trial,
        coordinate,
        scale[coordinate],
        whitened - basis @ (basis.T @ whitened),
    )
    found = kernel.fitted(
        rows - basis @ (basis.T @ rows),
        start=START_SPREAD,
        spreads=(LEAST_SPREAD, MOST_SPREAD),
        prior_sd=1.0,
    )
    sd = np.zeros(len(COORDINATES))
    sd[np.unique(coordinate)] = found.spread
    values, vectors = np.linalg.eigh(kernel.covariance(found.logs))
    is_kept = values > ROUNDING * values[-1]
    columns = np.zeros((*laxity.coordinates.shape, int(is_kept.sum())))
    columns[trial, coordinate] = vectors[:, is_kept] * np.sqrt(values[is_kept])
    return SmoothDiscrepancy(
        sd=sd * scale,
        flexion_length=found.flexion_length,
        load_length=found.load_length,
        columns=columns,
    )
