"""Wrapping: the medial collateral ligament is pushed aside where it passes the joint."""

from dataclasses import replace
from functools import partial

import numpy as np

from identknee.model.effects.effect import InputsChange, amplitudes, with_remeasured_lengths
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.runs.arrays import Array
from identknee.subject.anatomy import anatomy
from identknee.subject.knee import Knee

NAME = "mcl_wrapping"


def mcl_wrapping(knee: Knee) -> InputsChange:
    """Lift of the medial collateral ligament off its straight line, at the joint line [mm].

    The rim of the plateau and the meniscus push it medially. Its reference length is that of the
    lifted course. 2 to 8 mm is an estimate. Its length changes with the square of a small lift, so
    that the first derivative at zero is zero.

    Raises
    ------
    ValueError
        If no ligament of the subject runs as the medial collateral does.
    """
    found = anatomy(knee)
    if found.medial_collateral is None:
        raise ValueError(
            f"{NAME} needs a medial collateral ligament, and none of this knee's lines runs as it "
            "does; leave the effect out"
        )
    ligament = knee.ligament(found.medial_collateral)
    bottom, top = knee.tibia_frame.to_local([ligament.tibia, ligament.femur])[:, 1]
    index = [x.name for x in knee.ligaments].index(ligament.name)
    made = amplitudes(NAME, ["lift_mm"], [4.0], lower=[0.0], upper=[12.0])
    place = float((found.joint_line - bottom) / (top - bottom))
    return InputsChange(name=NAME, parameters=made, changed=partial(_with_wrapping, index, place))


def _with_wrapping(
    index: int, place: float, setting: MechanicsInputs, values: Array
) -> MechanicsInputs:
    is_lifted, lines = setting.owner == index, setting.lines
    course = replace(
        lines,
        # Medial is against femoral z.
        wrap_offset=np.where(is_lifted, -values[0], lines.wrap_offset),
        wrap_place=np.where(is_lifted, place, lines.wrap_place),
    )
    return with_remeasured_lengths(setting, course, is_lifted)
