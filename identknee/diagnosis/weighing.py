"""Measured laxity against a model, in units in which all errors are independent."""

from dataclasses import dataclass

import numpy as np

from identknee.calibrate.problem import WithPriors
from identknee.diagnosis.noise_model import NoiseModel
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """Residuals of a model in units of a noise model that trials may share.

    Attributes
    ----------
    compared
        Model and data, compared in mm and deg.
    noise
        The errors of the measured values.
    """

    compared: LaxityResiduals
    noise: NoiseModel

    @property
    def parameters(self) -> Parameters:
        """Those of the model."""
        return self.compared.parameters

    def residuals(self, theta: Array) -> Array:
        """Predicted less measured, whitened, shape ``(m,)``; infinite without a prediction."""
        residuals = self.compared.residuals(theta)
        return self.noise.whiten(residuals) if np.isfinite(residuals).all() else residuals

    def jacobian(self, theta: Array) -> Array:
        """Change of the residuals with theta, shape ``(m, p)``."""
        return self.noise.whiten(self.compared.jacobian(theta))


def weighed(model: LaxityModel, laxity: Laxity, noise: NoiseModel) -> WithPriors:
    """The problem of fitting the model to the data, the priors of all parameters included."""
    compared = LaxityResiduals(model=model, laxity=laxity)
    return WithPriors(problem=Weighed(compared=compared, noise=noise))
