"""The menisci as elastic wedges around the plateaus: a part of a knee like its capsule.

A wedge fills the gap between a plateau's periphery and the femur in the scanned pose, and presses
where the gap closes further. Hoop stress and motion of the menisci are not modelled.

References
----------
.. [1] Fukubayashi and Kurosawa (1980), Acta Orthop. Scand. 51(6), 871-879.
       https://doi.org/10.3109/17453678008990887
.. [2] Walker and Erkman (1975), Clin. Orthop. Relat. Res. 109, 184-192.
       https://doi.org/10.1097/00003086-197506000-00028
"""

from dataclasses import replace

import numpy as np

from identknee.mechanics.contact_points import RimDistance, rim_distance
from identknee.runs.declare import Array, BoolArray
from identknee.runs.errors import ValueRefused
from identknee.subject.anatomy import TYPICAL_WIDTH
from identknee.subject.knee import EffectChoice, Knee, StatedPrior

MENISCI = "meniscal_wedge"
SIDES = ("medial", "lateral")
# Pressure per compression [N/mm3], an estimate: under 1,000 N the menisci have 70 % of 1,150 mm2 of
# contact [1]_ and carry half of the load on the medial side and more on the lateral one [2]_. These
# 0.7 MPa compress them by about 0.7 mm. The spread is of its logarithm; cartilage has 10 N/mm3.
STIFFNESS, LOG_STIFFNESS_SD, MOST_STIFFNESS = 1.0, 1.0, 5.0
# How wide they are from the rim of a plateau inwards [mm] where both plateaus are as wide as
# usual, how much of the side towards the other plateau is left open [deg to either side], and how
# high they are at most [mm]: estimates.
WIDTH, OPEN_TO_INSIDE, HIGHEST = 10.0, 60.0, 8.0
# Largest offset of the wedges from the gaps in the scanned pose [mm], since the distance to the
# femur is tabulated up to FIELD_REACH only.
MOST_OFFSET = 2.0
FIELD_REACH = HIGHEST + MOST_OFFSET


def with_menisci(
    knee: Knee,
    *,
    medial_stiffness_N_per_mm3: float = STIFFNESS,
    lateral_stiffness_N_per_mm3: float = STIFFNESS,
    offset_mm: float = 0.0,
) -> Knee:
    """The knee with menisci among its effects.

    All verbs treat their stiffness like other parameters, with lognormal priors around these
    values: ``meniscal_wedge.medial_stiffness_N_per_mm3`` and the same of ``lateral``. A stiffness
    of 0 stands for a removed meniscus and is not fitted. The offset is fixed.

    Parameters
    ----------
    knee
        The subject.
    medial_stiffness_N_per_mm3, lateral_stiffness_N_per_mm3
        Pressure per compression of each meniscus, 0 to 5.
    offset_mm
        How much higher the wedges are than the gaps in the scanned pose, -2 to 2.

    Raises
    ------
    ValueError
        If a number is out of its range, a plateau has no rim, or the knee has menisci.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> dict(with_menisci(reference_knee(), lateral_stiffness_N_per_mm3=2.0).effects[0].values)
    {'medial_stiffness_N_per_mm3': 1.0, 'lateral_stiffness_N_per_mm3': 2.0, 'offset_mm': 0.0}
    """
    both = medial_stiffness_N_per_mm3, lateral_stiffness_N_per_mm3
    stiffness = dict(zip(SIDES, both, strict=True))
    for side, value in stiffness.items():
        if not 0.0 <= value <= MOST_STIFFNESS:
            raise ValueRefused(
                f"the stiffness of the {side} meniscus must be 0 to {MOST_STIFFNESS:g} N/mm3, got "
                f"{value:g}",
                f"write about {STIFFNESS:g} for an intact meniscus and 0 for a removed one",
            )
    if not abs(offset_mm) <= MOST_OFFSET:
        raise ValueRefused(
            f"the offset of the menisci must be {-MOST_OFFSET:g} to {MOST_OFFSET:g} mm, as far as "
            f"the distance to the femur is known around their gaps, got {offset_mm:g}",
            "correct it, or leave it out",
        )
    for side in plateaus_without_rim(knee):
        if stiffness[side]:
            raise ValueRefused(
                f"the {side} plateau of {knee.name} is a closed surface, without a rim that a "
                "meniscus could follow",
                f"give the articular surface alone, or write {side}_stiffness_N_per_mm3 = 0.0",
            )
    if any(x.name == MENISCI for x in knee.effects):
        raise ValueRefused(f"{knee.name} has menisci already", "state them once")
    removed = tuple(f"{x}_stiffness_N_per_mm3" for x, value in stiffness.items() if value == 0.0)
    values = {f"{x}_stiffness_N_per_mm3": float(value) for x, value in stiffness.items()}
    choice = EffectChoice(
        name=MENISCI,
        values={**values, "offset_mm": float(offset_mm)},
        fixed=(*removed, "offset_mm"),
    )
    stated = {
        f"{MENISCI}.{name}": StatedPrior(log_sd=LOG_STIFFNESS_SD, center=value)
        for name, value in values.items()
        if name not in removed
    }
    priors = {**stated, **knee.priors}
    return replace(knee, effects=(*knee.effects, choice), priors=priors, fitted={})


def plateaus_without_rim(knee: Knee) -> tuple[str, ...]:
    """The sides on which the surface of the tibia is closed."""
    sheets = zip(SIDES, knee.tibia, strict=True)
    return tuple(side for side, x in sheets if not len(rim_distance(x.vertices, x.faces).rim))


def width_of_menisci(knee: Knee) -> float:
    """How wide the menisci of a knee are [mm]: in proportion to its plateaus."""
    across = knee.tibia_frame.axes[2]
    medial, lateral = (x.vertices @ across for x in knee.tibia)
    return float(WIDTH * (lateral.max() - medial.min()) / TYPICAL_WIDTH)


def on_periphery(points: Array, rim: RimDistance, inward: float, width: float) -> BoolArray:
    """Which points of a plateau lie below its meniscus, shape ``(n,)``.

    Parameters
    ----------
    points
        In the frame of the tibia [mm], shape ``(n, 3)``.
    rim
        Distance from the plateau's rim.
    inward
        1 where the other plateau lies along the z axis, -1 where it lies against it.
    width
        Width of the meniscus [mm].
    """
    forward, _, across = (points - points.mean(axis=0)).T
    from_inside = np.degrees(np.arctan2(np.abs(forward), inward * across))
    return np.asarray((rim.at(points) <= width) & (from_inside > OPEN_TO_INSIDE))
