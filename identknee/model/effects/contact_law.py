"""Effects of the contact law and of the menisci."""

from dataclasses import field, replace

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.model.effects.effect import amplitudes
from identknee.model.mechanics_inputs import MechanicsInputs, with_lines
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry
from identknee.subject.anatomy import meniscus_springs
from identknee.subject.knee import Knee

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

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the other contact law."""
        law = replace(
            setting.law,
            modulus=setting.law.modulus * float(np.exp(values[0])),
            exponent=setting.law.exponent + float(values[1]),
        )
        return replace(setting, law=law)


def contact_nuisance() -> Cartilage:
    """Uncertainty of the contact law, as a nuisance parameter."""
    return Cartilage(name=CONTACT_LAW, modulus_sd=NUMERICAL_SD)


# A spring to so far a point resists motion along itself alone [mm].
FAR = 500.0
# Negative: linear in tension and compression.
BILATERAL = -1.0


@declared
class Meniscus:
    """Springs along and across each plateau, of one stiffness each side [N/mm].

    They are relaxed in the scanned pose.
    """

    name: str = entry("Name of the cause", default="meniscus")
    femoral: Array = array(
        "Ends of all springs in femoral axes, two springs for each amplitude",
        "4",
        "axis",
        unit="mm",
    )
    tibial: Array = array("Their ends in tibial axes", "4", "axis", unit="mm")
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = ["medial_N_per_mm", "lateral_N_per_mm"]
        made = amplitudes(self.name, names, [20.0, 20.0], lower=[0.0, 0.0], upper=[100.0, 100.0])
        object.__setattr__(self, "parameters", made)

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the springs added."""
        springs = LineLigaments(
            femoral=self.femoral,
            tibial=self.tibial,
            reference_length=np.full(4, FAR),
            transition=BILATERAL,
        )
        return with_lines(setting, springs, FAR * np.repeat(values, 2), np.zeros(4))


def meniscus(knee: Knee) -> Meniscus:
    """Shear stiffness of both menisci [N/mm], from the condyles' centres along the tibia's axes.

    5 to 50 N/mm is an estimate; models without menisci are known to lack a restraint of sliding.
    """
    ends = [
        (spring.femur, spring.femur + FAR * along)
        for spring in meniscus_springs(knee)
        for along in (spring.anterior, spring.lateral)
    ]
    return Meniscus(
        femoral=knee.femur_frame.to_local([x for x, _ in ends]),
        tibial=knee.tibia_frame.to_local([x for _, x in ends]),
    )
