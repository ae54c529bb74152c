"""Insertions: the subject's ligaments begin and end beside where they were segmented."""

from dataclasses import replace

import numpy as np

from identknee.model.effects.changes import CopiesChange, remeasured
from identknee.model.effects.effect import amplitudes
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

SHIFT_SD, SHIFT_LIMIT = 2.0, 8.0  # mm
BONES, AXES = ("femur", "tibia"), ("x", "y", "z")


def insertion(knee: Knee) -> CopiesChange:
    """Shifts of both insertions of every ligament along the axes of their bone [mm].

    The reference length is that between the shifted insertions in the scanned pose. Errors of 1 to
    4 mm are an estimate of what segmentation leaves.
    """
    names = [
        f"{x.name}_{bone}_{axis}_mm" for x in knee.ligaments for bone in BONES for axis in AXES
    ]
    n = len(names)
    made = amplitudes("insertion", names, n * [SHIFT_SD], upper=n * [SHIFT_LIMIT])
    return CopiesChange(name="insertion", parameters=made, changed=_shifted)


def _shifted(setting: Setting, values: Array) -> Setting:
    is_own = setting.owner >= 0
    shifts = np.zeros((len(is_own), 2, 3))
    of_ligament = np.moveaxis(values.reshape(*values.shape[:-1], -1, 2, 3), -3, 0)
    copies = () if values.ndim == 1 else (setting.copy[is_own],)
    shifts[is_own] = of_ligament[setting.owner[is_own], *copies]
    lines = setting.lines
    moved = replace(lines, femoral=lines.femoral + shifts[:, 0], tibial=lines.tibial + shifts[:, 1])
    return remeasured(setting, moved, is_own)
