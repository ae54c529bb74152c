"""Contact: how stiff cartilage is, and how its pressure grows with depth."""

from dataclasses import field, replace

import numpy as np

from identknee.model.effects.effect import amplitudes
from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry

CONTACT_LAW = "contact_law"
# Of the logarithm of the modulus: what cartilage may be, and what a computation may get wrong.
CARTILAGE_SD, NUMERICAL_SD = 0.7, 0.15
# A law with another exponent than 1 is as stiff at the depth that the exponent leaves alone.
EXPONENT_SD = 0.3


@declared
class Cartilage:
    """Another contact law: logarithm of the modulus over the paper's and change of the exponent."""

    name: str = entry("Name of the cause", default="cartilage")
    modulus_sd: float = entry(
        "Prior standard deviation of the logarithm of the modulus", default=CARTILAGE_SD
    )
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        made = amplitudes(
            self.name,
            ["ln_modulus", "exponent"],
            [self.modulus_sd, EXPONENT_SD],
            lower=[-2.5, -0.3],
            upper=[2.5, 1.5],
        )
        object.__setattr__(self, "parameters", made)

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting under the other contact law."""
        law = replace(
            setting.law,
            modulus=setting.law.modulus * float(np.exp(values[0])),
            exponent=setting.law.exponent + float(values[1]),
        )
        return replace(setting, law=law)


def contact_nuisance() -> Cartilage:
    """How far any contact law may be from the knee's own, as a nuisance that is no cause."""
    return Cartilage(name=CONTACT_LAW, modulus_sd=NUMERICAL_SD)
