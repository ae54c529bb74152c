"""The posterior cell by cell of the measured table, as ArviZ compares and checks models."""

from itertools import product

import numpy as np

from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_COORDINATE, array, declared, derived, entry
from identknee.verbs.sample_records import CHAIN, Predictive


@declared
class CellValues:
    """The measured values in a row."""

    laxity: Array = array("Measured laxity", "cell", unit=OF_COORDINATE)


@declared
class CellDensity:
    """Log density of the measured values, under the name of what it is a density of."""

    laxity: Array = array(
        "Log density of each measured value, given those before it in its trial", *CHAIN, "cell"
    )


@declared
class CellDraws:
    """Laxity as it would be measured again, at draws of the posterior."""

    laxity: Array = array(
        "Laxity as it would be measured again, with noise", *CHAIN, "cell", unit=OF_COORDINATE
    )


@declared
class MeasuredCells:
    """Every measured value with its likelihood and predictions, at the predicted draws."""

    names: tuple[str, ...] = array(
        "Trial and coordinate of each measured value", "cell", is_in_arrays=False
    )
    measured: CellValues = entry("Measured values", group="observed_data", is_in_json=False)
    log_likelihood: CellDensity = entry(
        "Likelihood of the measured values", group="log_likelihood", is_in_json=False
    )
    replicated: CellDraws = entry(
        "Predictions of the measured values", group="posterior_predictive", is_in_json=False
    )

    @property
    @derived("Measured values", unit="1")
    def n_cells(self) -> int:
        """How many values were measured."""
        return len(self.names)


def measured_cells(residuals: LaxityResiduals, predictive: Predictive, seed: int) -> MeasuredCells:
    """The measured values with their likelihood and predictions at the draws of `predictive`.

    Parameters
    ----------
    residuals
        Residuals of the model against the data, weighted by their noise.
    predictive
        Predictions of the same model under the trials of the data.
    seed
        Seed of the noise on the predictions.
    """
    laxity = residuals.laxity
    coordinates = predictive.coordinates[0]
    density = np.array([residuals.log_density(x) for x in coordinates])
    predicted = np.array([residuals.as_measured(x) for x in coordinates])
    noisy = predicted + _errors(laxity, len(predicted), seed)
    cells = zip(
        product(laxity.protocol.trials, COORDINATES), laxity.is_measured.ravel(), strict=True
    )
    return MeasuredCells(
        names=tuple(f"{trial} {name}" for (trial, name), is_measured in cells if is_measured),
        measured=CellValues(laxity=laxity.coordinates[laxity.is_measured]),
        log_likelihood=CellDensity(laxity=density[None]),
        replicated=CellDraws(laxity=noisy[:, laxity.is_measured][None]),
    )


def _errors(laxity: Laxity, n: int, seed: int) -> Array:
    """Draws of the measurement error [mm, deg], shape ``(n, trials, 5)``."""
    k = len(COORDINATES)
    shared = np.full((k, k), laxity.within_trial_correlation)
    np.fill_diagonal(shared, 1.0)
    draws = np.random.default_rng(seed).standard_normal((n, laxity.n, k))
    return np.asarray(laxity.sd * np.einsum("ij,mnj->mni", np.linalg.cholesky(shared), draws))
