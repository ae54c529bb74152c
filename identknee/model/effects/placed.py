"""Structures placed on a subject's bones."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from identknee.model.effects.capsule import PosteriorCapsule
from identknee.model.effects.structures import SITE_SD, MissingStructure, structure_at
from identknee.subject.effect_choice import Points
from identknee.subject.knee import Knee

CAPSULE = "posterior_capsule"
# Prior standard deviation of the stiffness of structures [kN]; of any other name, the last.
STIFFNESS_SD: Mapping[str, float] = MappingProxyType(
    {
        "anterolateral": 1.2,
        "posteromedial": 1.5,
        "popliteofibular": 1.2,
        "deep_mcl": 1.2,
        CAPSULE: 1.0,
    }
)
OTHER_STIFFNESS_SD = 1.5
# mm; the lines of the capsule stand for sheets as wide as a condyle.
CAPSULE_SITE_SD = 6.0
Structure = MissingStructure | PosteriorCapsule


def structure(
    knee: Knee,
    name: str,
    lines: Sequence[Points],
    *,
    stiffness_sd: float | None = None,
    site_sd: float | None = None,
) -> Structure:
    """A missing structure between points of the common frame of the scan.

    The posterior capsule has a medial and then a lateral line, each with its own stiffness and
    shifts; the lines of any other structure share them.

    Parameters
    ----------
    knee
        The subject.
    name
        Name of the structure.
    lines
        Femoral and tibial point [mm] of each line, shape ``(3,)``.
    stiffness_sd
        Scale of the half-normal prior of the stiffness [kN]; the named structure's where None.
    site_sd
        Prior standard deviation of the shifts of both ends [mm], 0 where they are not shifted; the
        usual one where None.

    Raises
    ------
    ValueError
        If a posterior capsule has not two lines.
    """
    sd = stiffness_sd or STIFFNESS_SD.get(name, OTHER_STIFFNESS_SD)
    usual = CAPSULE_SITE_SD if name == CAPSULE else SITE_SD
    spread = usual if site_sd is None else site_sd

    def made(lines: Sequence[Points]) -> MissingStructure:
        at = structure_at(knee, name, lines, stiffness_sd=sd, sites_vary=spread > 0.0)
        return replace(at, site_sd=spread)

    if name != CAPSULE:
        return made(lines)
    if len(lines) != 2:
        raise ValueError(f"{CAPSULE} has a medial and a lateral line, got {len(lines)} lines")
    medial, lateral = (made([line]) for line in lines)
    return PosteriorCapsule(medial=medial, lateral=lateral)


def lines_of(knee: Knee, made: Structure) -> tuple[Points, ...]:
    """The points between which the lines of a structure run, in the common frame [mm]."""
    parts = (made.medial, made.lateral) if isinstance(made, PosteriorCapsule) else (made,)
    return tuple(
        (knee.femur_frame.to_common(femur), knee.tibia_frame.to_common(tibia))
        for part in parts
        for femur, tibia in zip(part.femoral, part.tibial, strict=True)
    )
