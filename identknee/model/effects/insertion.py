"""Insertion errors: ligament attachments displaced from their segmented positions."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from identknee.model.effects.effect import (
    InputsChange,
    PartOfEffect,
    amplitudes,
    effect_of,
    with_remeasured_lengths,
)
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.knee import AXES, BONES, Knee

SHIFT_SD, SHIFT_LIMIT = 2.0, 8.0  # mm


def insertion(knee: Knee) -> InputsChange:
    """Shifts of both insertions of every ligament along the axes of their bone [mm].

    The reference length is that between the shifted insertions in the scanned pose. The size,
    errors of segmentation of 1 to 4 mm, is an estimate.
    """
    names = [
        f"{x.name}_{bone}_{axis}_mm" for x in knee.ligaments for bone in BONES for axis in AXES
    ]
    n = len(names)
    return effect_of(
        *(InputsChange, "insertion", names, n * [SHIFT_SD]),
        upper=n * [SHIFT_LIMIT],
        changed=_shifted,
        differs_by_replica=True,
    )


def _shifted(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    is_own = setting.owner >= 0
    shifts = np.zeros((len(is_own), 2, 3))
    of_ligament = np.moveaxis(values.reshape(*values.shape[:-1], -1, 2, 3), -3, 0)
    copies = () if values.ndim == 1 else (setting.copy[is_own],)
    shifts[is_own] = of_ligament[setting.owner[is_own], *copies]
    lines = setting.lines
    moved = replace(lines, femoral=lines.femoral + shifts[:, 0], tibial=lines.tibial + shifts[:, 1])
    return with_remeasured_lengths(setting, moved, is_own)


# The insertions of one specimen (s192803) from CT and from MRI differ by 9 mm rms, that is 5 mm
# along each axis (docs/uncertain_geometry.md).
GROSS_SD, FARTHEST = 5.0, 25.0  # mm
# Names of the positive and the negative direction along x, y and z of a right knee.
WAYS = (("anterior", "posterior"), ("proximal", "distal"), ("lateral", "medial"))
# Shifts below this share of the largest are not reported.
LEAST_NAMED = 0.25


@declared
class InsertionShift(PartOfEffect):
    """A gross shift of one insertion, beside the small shifts of all insertions [mm]."""

    ligament: str = entry("Ligament whose insertion it is")
    bone: str = entry("Bone on which the insertion lies")

    @property
    def variant(self) -> str:
        """Which insertion it is."""
        return f"{self.ligament}_{self.bone}"

    def applied(self, knee: Knee, values: Array) -> Knee:
        """The knee with the insertion shifted by `values` [mm], shape ``(3,)``."""
        frame = knee.femur_frame if self.bone == BONES[0] else knee.tibia_frame
        ligaments = [
            replace(x, **{self.bone: getattr(x, self.bone) + values @ frame.axes})
            if x.name == self.ligament
            else x
            for x in knee.ligaments
        ]
        return replace(knee, ligaments=tuple(ligaments))


def moved_insertion(knee: Knee, ligament: str, bone: str) -> InsertionShift:
    """The insertion of a ligament on a bone, ``"femur"`` or ``"tibia"``, as a cause of its own.

    Raises
    ------
    ValueError
        If there is no such ligament or bone.
    """
    shifts = insertion(knee)
    place = 2 * [x.name for x in knee.ligaments].index(ligament) + BONES.index(bone)
    names = [f"{ligament}_{bone}_{way}_mm" for way, _ in WAYS]
    n = len(WAYS)
    made = amplitudes(shifts.name, names, n * [GROSS_SD], upper=n * [FARTHEST])
    moved = n * place + np.arange(n)
    return InsertionShift(ligament=ligament, bone=bone, whole=shifts, moved=moved, parameters=made)


def direction_words(shifts: Mapping[str, float]) -> str:
    """Direction in which an insertion is displaced; empty for other causes.

    Parameters
    ----------
    shifts
        Shifts by their names in `moved_insertion` [mm].

    Examples
    --------
    >>> shifts = {"anterior": 0.2, "proximal": -6.0, "lateral": 1.1}
    >>> direction_words({f"PT_tibia_{way}_mm": x for way, x in shifts.items()})
    'The insertion of the PT on the tibia lies 6.0 mm more distal than given.'
    """
    ways = {f"_{way}_mm": (way, back) for way, back in WAYS}
    found = {name: end for name in shifts for end in ways if name.endswith(end)}
    if len(found) != len(WAYS) or len(found) != len(shifts):
        return ""
    name, end = next(iter(found.items()))
    ligament, _, bone = name.removesuffix(end).rpartition("_")
    largest = max(abs(x) for x in shifts.values())
    phrases = [
        f"{abs(shifts[x]):.1f} mm more {ways[end][shifts[x] < 0.0]}"
        for x, end in sorted(found.items(), key=lambda item: -abs(shifts[item[0]]))
        if abs(shifts[x]) >= LEAST_NAMED * largest
    ]
    return f"The insertion of the {ligament} on the {bone} lies {' and '.join(phrases)} than given."
