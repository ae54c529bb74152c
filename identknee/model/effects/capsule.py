"""Posterior capsule: two lines that differ in stiffness."""

from dataclasses import dataclass, field

import numpy as np

from identknee.model.effects.effect import amplitudes
from identknee.model.effects.structures import MissingStructure
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array

SIDES = ("medial", "lateral")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosteriorCapsule:
    """The medial and the lateral capsule, stiffnesses of their own and one reference strain.

    Attributes
    ----------
    medial, lateral
        Structures of one line each whose sites do not vary.
    parameters
        Both stiffnesses, then the strain.
    """

    medial: MissingStructure
    lateral: MissingStructure
    name: str = "posterior_capsule"
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        medial, lateral = self.medial.parameters, self.lateral.parameters
        made = amplitudes(
            self.name,
            [*(f"{side}_{STIFFNESS}" for side in SIDES), STRAIN],
            [medial.prior_sd[0], *lateral.prior_sd],
            lower=[medial.lower[0], *lateral.lower],
            upper=[medial.upper[0], *lateral.upper],
            center=[medial.center[0], *lateral.center],
        )
        object.__setattr__(self, "parameters", made)

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with both lines in place."""
        medial, lateral, strain = values
        setting = self.medial.change(setting, np.array([medial, strain]))
        return self.lateral.change(setting, np.array([lateral, strain]))
