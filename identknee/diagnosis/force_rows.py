"""Measured forces as rows of a fit, and what causes and nuisances change in them."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from identknee.checks.usable_trials import force_terms
from identknee.laxity.table import Laxity
from identknee.model.effects.effect import Effect, amplitudes
from identknee.model.effects.loads import LoadError
from identknee.model.effects.tissues import toe_strain
from identknee.model.force_residuals import ForceResiduals, SuperpositionResiduals
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances import flexion
from identknee.model.residuals import (
    ROUGHNESS_LENGTH,
    SURFACE_LENGTH,
    has_shared_errors,
    shared_errors,
    surface_gradients,
)
from identknee.runs.declare import Array, IntArray, declared, entry

# An added load on the tibia (varus, internal [N mm], x, y, z [N]), for derivatives by loads.
FURTHER = "further_load"
SIZES = (1000.0, 1000.0, 10.0, 10.0, 10.0)


@declared
class ForceRows:
    """The measured forces of data, f values in units of their errors, under one model."""

    model: LaxityModel = entry("The model under the protocol of the data")
    laxity: Laxity = entry("The data")

    @property
    def terms(self) -> dict[str, ForceResiduals | SuperpositionResiduals]:
        """Their residuals by the name of the term; none without forces."""
        return force_terms(self.model, self.laxity)

    @property
    def n(self) -> int:
        """Number of forces, f."""
        return sum(x.n for x in self.terms.values())

    @property
    def trials(self) -> IntArray:
        """The trial of each force, shape ``(f,)``."""
        return np.concatenate([np.zeros(0, np.int64), *(x.trials for x in self.terms.values())])

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by the parameters, shape ``(f, p)``."""
        rows = [x.jacobian(theta) for x in self.terms.values()]
        return np.concatenate([np.zeros((0, theta.size)), *rows])

    def under(self, effects: Sequence[Effect]) -> "ForceRows":
        """Rows of the model with these effects added to its own."""
        model = self.model.with_effects([*self.model.effects, *effects])
        return ForceRows(model=model, laxity=self.laxity)

    def changes(self, theta: Array, gradients: Array) -> Array:
        """Changes of the forces, ``(f, k)``, by additions (n, 5, k) to the gradient of the energy.

        They act as a load of the opposite sign.
        """
        by_load = _by_load(self, np.asarray(theta, float).tobytes())
        return np.asarray(-np.einsum("fi,fik->fk", by_load, gradients[self.trials]))

    def nuisances(self, theta: Array) -> Array:
        """Changes of the forces by a unit of each nuisance of `nuisance_changes`, ``(f, k)``."""
        model, stated = self.model, self.model.knee.uncertainty
        prediction = model.predict_once(theta)
        blocks = [self.changes(theta, surface_gradients(model, prediction, ROUGHNESS_LENGTH))]
        toe = toe_strain()
        if toe.name not in {x.name for x in model.effects}:
            blocks.append(self.under([toe]).jacobian(np.r_[theta, 0.0])[:, -1:])
        if has_shared_errors(stated):
            own: list[Array] = []
            if stated.trial_flexion_deg > 0.0:
                offset = flexion(stated.trial_flexion_deg)
                others = [x for x in model.effects if x.name != offset.name]
                extended = ForceRows(
                    model=model.with_effects([*others, offset]), laxity=self.laxity
                )
                known = dict(zip(model.parameters.names, theta, strict=True))
                here = [known.get(x, 0.0) for x in extended.model.parameters.names]
                slopes = stated.trial_flexion_deg * extended.jacobian(np.array(here))[:, -1]
                own.append(slopes[:, None] * (self.trials[:, None] == np.arange(self.laxity.n)))
            if stated.surface_mm > 0.0:
                moved = surface_gradients(model, prediction, SURFACE_LENGTH)
                own.append(stated.surface_mm * self.changes(theta, moved))
            # Errors of zeros change coordinates only, not forces.
            n = shared_errors(model, theta).shape[2] - sum(x.shape[1] for x in own)
            blocks += [np.zeros((self.n, n)), *own]
        return np.concatenate(blocks, axis=1)


@lru_cache(maxsize=4)
def _by_load(rows: ForceRows, theta: bytes) -> Array:
    """Derivatives of forces by a generalised load on the tibia, shape ``(f, 5)``."""
    names = ("varus_Nmm", "internal_Nmm", "x_N", "y_N", "z_N")
    made = amplitudes(FURTHER, names, SIZES, upper=SIZES)
    load = LoadError(name=FURTHER, parameters=made, acted=_loaded)
    jacobian = rows.under([load]).jacobian(np.r_[np.frombuffer(theta), np.zeros(len(names))])
    return jacobian[:, -len(names) :]


def _loaded(loads: Array, _flexion: Array, values: Array) -> Array:
    return loads + values
