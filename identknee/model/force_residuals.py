"""Residuals of measured forces: of ligaments, groups and compartments, in units of their errors."""

from dataclasses import dataclass, field

import numpy as np

from identknee.laxity.forces import MeasuredForces
from identknee.model.contact_loads import contact_jacobian, contact_values
from identknee.model.experiments import gone_in, members_of
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import (
    structure_loads,
    values_of_structures,
)
from identknee.model.parameters import Parameters
from identknee.model.quantities import CONTACT, quantity_place
from identknee.runs.arrays import Array, IntArray, short_repr
from identknee.runs.errors import ValueRefused


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceResiduals:
    """Predicted less measured forces, in standard deviations of their errors.

    Attributes
    ----------
    model
        The model under the protocol of the data.
    forces
        The measured forces.
    is_everywhere
        Whether forces of trials without equilibrium are left out, as in a search that begins
        anywhere; otherwise their residuals are infinite.

    Raises
    ------
    ValueError
        If the model lacks a structure whose force was measured, or it is cut in that trial.
    """

    model: LaxityModel
    forces: MeasuredForces
    is_everywhere: bool = False
    _places: tuple[tuple[str, int], ...] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Check that the model has what was measured."""
        protocol, forces, knee = self.model.protocol, self.forces, self.model.knee
        for trial, k in np.argwhere(forces.is_measured).tolist():
            owner = forces.names[k].rpartition(".")[0]
            if members_of(knee, owner) <= gone_in(knee, protocol.states[trial]):
                raise ValueRefused(
                    f"the table has the force of {owner} in {protocol.trials[trial]}, where it is "
                    "cut",
                    "leave that cell blank",
                )
        places = tuple(quantity_place(self.model, x) for x in forces.names)
        object.__setattr__(self, "_places", places)

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def n(self) -> int:
        """Number of measured forces."""
        return int(self.forces.is_measured.sum())

    @property
    def trials(self) -> IntArray:
        """Index of the trial of each force, shape ``(n,)``."""
        return np.nonzero(self.forces.is_measured)[0]

    def predicted(self, theta: Array) -> Array:
        """The forces of all trials, shape ``(trials, forces)``; NaN without an equilibrium."""
        prediction = self.model.predict_once(theta)
        is_contact = np.array([kind == CONTACT for kind, _ in self._places])
        of_contact = [i for kind, i in self._places if kind == CONTACT]
        values = np.empty(self.forces.values.shape)
        values[:, is_contact] = contact_values(prediction)[:, of_contact, 0]
        if not is_contact.all():
            names = [x.rpartition(".")[0] for x in np.array(self.forces.names)[~is_contact]]
            values[:, ~is_contact] = values_of_structures(self.model, prediction, names)[0]
        return values

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(n,)``."""
        measured = self.forces.is_measured
        left = (self.predicted(theta) - self.forces.values)[measured] / self._sd
        return np.where(np.isnan(left), 0.0 if self.is_everywhere else np.inf, left)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by theta, shape ``(n, p)``."""
        prediction, measured = self.model.predict_once(theta), self.forces.is_measured
        slopes = np.zeros((*measured.shape, self.parameters.n))
        kinds = [kind for kind, _ in self._places]
        if CONTACT in kinds:
            of_contact = measured[:, [x == CONTACT for x in kinds]].any(axis=1)
            trials = np.flatnonzero(of_contact).tolist()
            contact = contact_jacobian(self.model, prediction, trials)
        if set(kinds) != {CONTACT}:
            tensions = structure_loads(self.model, prediction).tension_jacobian
        for k, (kind, i) in enumerate(self._places):
            if kind == CONTACT:
                slopes[trials, k] = contact[:, i, 0]
            else:
                slopes[:, k] = tensions[:, i]
        rows = slopes[measured] / self._sd[:, None]
        return np.nan_to_num(rows) if self.is_everywhere else rows

    @property
    def _sd(self) -> Array:
        return np.asarray(self.forces.sd[self.forces.is_measured])
