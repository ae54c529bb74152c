"""The difference between a model's prediction and measured laxity, as residuals for calibration."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from identknee.laxity.table import COORDINATES, Laxity, noise_fault
from identknee.laxity.zero_conventions import from_zero
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, IntArray, short_repr
from identknee.runs.marginalise import whitening

Weighting = Literal["unit", "noise"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaxityResiduals:
    """Residuals of a laxity model against measured laxity.

    Attributes
    ----------
    model
        The model; its protocol is replaced by that of the data.
    laxity
        The data. Coordinates not measured are left out.
    weighting
        ``"unit"`` for plain differences in mm and deg (equation 6 of the paper), ``"noise"`` for
        differences divided by the stated errors, with the correlation that the errors of a trial
        share taken out.
    shared
        What further errors of one standard deviation change in the coordinates, shape
        ``(n, 5, k)``: they are averaged over, as errors that many values share. None for none.
    offset
        What is added to predicted coordinates [mm, deg], shape ``(n, 5)``; nothing if None.

    Raises
    ------
    ValueError
        If noise weighting is asked for and a measured coordinate has no standard deviation, if
        there are shared errors without noise weighting, or if the data are relative to an unloaded
        pose that their protocol lacks.
    """

    model: LaxityModel
    laxity: Laxity
    weighting: Weighting = "unit"
    shared: Array | None = None
    offset: Array | None = None
    _whitening: Array = field(init=False, repr=False)
    _left: Array | None = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", self.model.with_tests(self.laxity))
        self.as_measured(self.laxity.coordinates)
        object.__setattr__(self, "_whitening", _by_trial(self.laxity, self.weighting))
        object.__setattr__(self, "_left", None)
        if self.shared is not None:
            if self.weighting == "unit":
                raise ValueError("shared errors need residuals in units of their noise")
            object.__setattr__(self, "_left", whitening(self.rows(self.shared)))

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def units(self) -> IntArray:
        """Unit of the coordinate behind each residual, shape ``(m,)``: 0 for mm, 1 for deg."""
        by_coordinate = np.array([int(name.endswith("_deg")) for name in COORDINATES])
        return np.broadcast_to(by_coordinate, (self.laxity.n, 5))[self.laxity.is_measured]

    def residuals(self, theta: Array) -> Array:
        """Predicted less measured coordinates, weighted, shape ``(m,)``.

        All are infinite where a trial with data has no equilibrium at theta.
        """
        # Its derivatives cost next to nothing here, and the Jacobian is mostly wanted here too.
        is_smooth = self.model.contact == "field"
        prediction = (
            self.model.predict_once(theta)
            if is_smooth
            else self.model.predict(theta, derivatives=False)
        )
        measured = self.laxity.is_measured
        if not prediction.is_converged[measured.any(axis=1)].all():
            return np.full(int(measured.sum()), np.inf)
        return self.weighted(-self._difference(prediction.coordinates))

    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m, p)``; NaN where they are infinite.

        Raises
        ------
        ValueError
            For mesh contact, which has no derivatives.
        """
        jacobian = self.model.predict_once(theta).jacobian
        if jacobian is None:  # pragma: no cover - it was asked for
            raise AssertionError
        return self.weighted(self.as_measured(jacobian))

    def differences(self, theta: Array) -> Array:
        """Measured less predicted coordinates, shape ``(n, 5)``; NaN where either is missing."""
        return self._difference(self.model.predict_once(theta).coordinates)

    def rows(self, values: Array) -> Array:
        """The rows of changes of the coordinates (n, 5, ...) that belong to residuals.

        Shape ``(m, ...)``, weighted as the residuals are.
        """
        return self.weighted(self.as_measured(values))

    def log_density(self, coordinates: Array) -> Array:
        """Log density of each measured value where the model predicts `coordinates`, ``(m,)``.

        Errors are normal; a value is taken given those before it in its trial, with which it may
        be correlated, so that the sum is that of the whole table.

        Parameters
        ----------
        coordinates
            As predicted [mm, deg], shape ``(n, 5)``; the density is zero where they are NaN.
        """
        measured = self.laxity.is_measured
        with np.errstate(invalid="ignore"):
            errors = self.weighted(self.as_measured(coordinates) - self.laxity.coordinates)
        scale = np.diagonal(self._whitening, axis1=1, axis2=2)[measured]
        density = np.log(scale) - 0.5 * (errors**2 + np.log(2.0 * np.pi))
        return np.where(np.isnan(density), -np.inf, density)

    def as_measured(self, values: Array) -> Array:
        """Predicted coordinates, or changes of them ``(n, 5, ...)``, from the zero of the data."""
        return from_zero(values, self.laxity.protocol, self.laxity.zero)

    def _difference(self, predicted: Array) -> Array:
        shown = predicted if self.offset is None else predicted + self.offset
        return np.asarray(self.laxity.coordinates - self.as_measured(shown))

    def weighted(self, values: Array) -> Array:
        """Rows of errors of the measured coordinates, whitened as the residuals are.

        Parameters
        ----------
        values
            Errors of all coordinates, shape ``(n, 5, ...)``; those not measured are left out.
        """
        measured = self.laxity.is_measured
        if self.weighting == "unit":
            return np.asarray(values[measured])
        known = np.where(measured.reshape(*measured.shape, *(1,) * (values.ndim - 2)), values, 0.0)
        whitened: Array = np.einsum("nij,nj...->ni...", self._whitening, known)
        rows = whitened[measured]
        return rows if self._left is None else self._left @ rows


def _by_trial(laxity: Laxity, weighting: Weighting) -> Array:
    """The matrix (5, 5) of each trial that turns its errors into independent ones of variance 1."""
    n = len(COORDINATES)
    matrices = np.zeros((laxity.n, n, n))
    if weighting == "unit":
        return matrices
    measured = laxity.is_measured
    if laxity.sd is None or np.isnan(laxity.sd[measured]).any():
        raise ValueError(
            "weighting by noise needs a standard deviation for every measured coordinate; "
            "add the columns sd_<coordinate> or use unit weighting"
        )
    for value in (laxity.sd[measured].min(initial=1.0), laxity.sd[measured].max(initial=1.0)):
        if fault := noise_fault(float(value)):
            raise ValueError(". ".join(fault))
    shared = np.full((n, n), laxity.within_trial_correlation)
    np.fill_diagonal(shared, 1.0)
    for trial in range(laxity.n):
        used = np.flatnonzero(measured[trial])
        sd = laxity.sd[trial, used]
        covariance = sd[:, None] * shared[np.ix_(used, used)] * sd
        # Rounding and standard deviations of very different size may leave no inverse.
        try:
            matrices[trial][np.ix_(used, used)] = np.linalg.inv(np.linalg.cholesky(covariance))
        except np.linalg.LinAlgError:
            raise ValueError(
                f"the noise of trial {laxity.protocol.trials[trial]} has no inverse: the "
                f"within-trial correlation is {laxity.within_trial_correlation!r} and the standard "
                f"deviations are {sd.min():g} to {sd.max():g}; give a correlation further from "
                "its limits and standard deviations of like size"
            ) from None
    return matrices
