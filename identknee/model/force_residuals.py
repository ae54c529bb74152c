"""Residuals of measured forces: of ligaments, groups and compartments, in units of their errors."""

from dataclasses import dataclass, field

import numpy as np

from identknee.laxity.experiments import cuts_of
from identknee.laxity.forces import MeasuredForces
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.model.quantities import AT, PredictedQuantity, quantity_named
from identknee.runs.arrays import Array, short_repr
from identknee.runs.errors import ValueRefused


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceResiduals:
    """Predicted less measured forces, in standard deviations of their errors.

    Attributes
    ----------
    model
        The model under the protocol of the data.
    forces
        What was measured.
    is_everywhere
        Whether a trial without equilibrium leaves its forces out, as in a search that begins
        anywhere; all residuals are infinite otherwise.

    Raises
    ------
    ValueError
        If the model lacks a structure of which the force was measured, or it is cut in that trial.
    """

    model: LaxityModel
    forces: MeasuredForces
    is_everywhere: bool = False
    _quantities: tuple[tuple[int, PredictedQuantity], ...] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        protocol, forces = self.model.protocol, self.forces
        quantities = []
        for trial, k in np.argwhere(forces.is_measured).tolist():
            owner = forces.names[k].rpartition(".")[0]
            cuts = cuts_of("" if protocol.state is None else protocol.state[trial])
            if any(x.ligament == owner and not x.is_partial for x in cuts):
                raise ValueRefused(
                    f"the table has the force of {owner} in {protocol.trials[trial]}, where it is "
                    "cut",
                    "leave that cell blank",
                )
            name = f"{forces.names[k]}{AT}{protocol.trials[trial]}"
            quantities.append((trial, quantity_named(self.model, name)))
        object.__setattr__(self, "_quantities", tuple(quantities))

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def n(self) -> int:
        """How many forces were measured."""
        return len(self._quantities)

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(n,)``."""
        found = np.array([x.evaluate(theta)[0] for _, x in self._quantities])
        left = (found - self.forces.values[self.forces.is_measured]) / self._sd
        return np.where(np.isnan(left), 0.0 if self.is_everywhere else np.inf, left)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by theta, shape ``(n, p)``."""
        slopes = np.array([x.evaluate(theta)[1] for _, x in self._quantities])
        slopes = slopes.reshape(self.n, self.parameters.n) / self._sd[:, None]
        return np.nan_to_num(slopes) if self.is_everywhere else slopes

    @property
    def _sd(self) -> Array:
        return np.asarray(self.forces.sd[self.forces.is_measured])
