"""Missing structures: lines that the model of the subject lacks."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.model.effects.effect import amplitudes
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.setting import Setting, with_lines
from identknee.runs.arrays import Array, frozen
from identknee.subject.knee import Knee

SITE_SD = 4.0  # mm, how far insertions are from where anatomy puts them
SITE_SDS = 3.0  # how many of these they may be away
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MissingStructure:
    """Lines of one stiffness and one reference strain, at sites that may be shifted.

    Attributes
    ----------
    name
        Of the structure.
    femoral, tibial
        Insertions in femoral and tibial axes [mm], shape ``(m, 3)``.
    stiffness_sd
        Of the half-normal prior of the stiffness [kN].
    sites_vary
        Whether both insertions may be shifted; all lines are shifted together.
    site_sd
        Prior standard deviation of each shift [mm].
    """

    name: str
    femoral: Array
    tibial: Array
    stiffness_sd: float
    sites_vary: bool = True
    site_sd: float = SITE_SD
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for bone in ("femoral", "tibial"):
            object.__setattr__(self, bone, frozen(getattr(self, bone), None, 3, name=bone))
        names, sd = [STIFFNESS, STRAIN], [self.stiffness_sd, 4.0]
        lower, upper = [0.0, -10.0], [6.0 * self.stiffness_sd, 12.0]
        if self.sites_vary:
            names += [f"{bone}_{axis}_mm" for bone in ("femur", "tibia") for axis in AXES]
            sd += 6 * [self.site_sd]
            lower += 6 * [-SITE_SDS * self.site_sd]
            upper += 6 * [SITE_SDS * self.site_sd]
        center = [0.0, 1.5, *[0.0] * (len(names) - 2)]
        made = amplitudes(self.name, names, sd, lower=lower, upper=upper, center=center)
        object.__setattr__(self, "parameters", made)

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with the structure in place."""
        shift = values[2:] if self.sites_vary else np.zeros(6)
        m = len(self.femoral)
        unmeasured = Lines(
            femoral=self.femoral + shift[:3],
            tibial=self.tibial + shift[3:],
            reference_length=np.ones(m),
        )
        lines = Lines(
            femoral=unmeasured.femoral,
            tibial=unmeasured.tibial,
            reference_length=setting.lengths_at_start(unmeasured),
        )
        return with_lines(
            setting, lines, np.full(m, 1000.0 * values[0]), np.full(m, 0.01 * values[1])
        )


def structure_at(
    knee: Knee,
    name: str,
    insertions: Sequence[tuple[Array, Array]],
    *,
    stiffness_sd: float,
    sites_vary: bool = True,
) -> MissingStructure:
    """A missing structure at femoral and tibial points in the common frame of the scan [mm]."""
    return MissingStructure(
        name=name,
        femoral=knee.femur_frame.to_local(np.array([x for x, _ in insertions])),
        tibial=knee.tibia_frame.to_local(np.array([x for _, x in insertions])),
        stiffness_sd=stiffness_sd,
        sites_vary=sites_vary,
    )
