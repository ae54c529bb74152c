"""Errors of the geometry: insertions and the pose of the scan; and of the laws of the tissues."""

from dataclasses import replace
from functools import partial

import numpy as np

from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.effects.changes import SettingChange
from identknee.model.effects.effect import amplitudes
from identknee.model.effects.insertion import AXES, insertion
from identknee.model.nuisances.loading import REACH
from identknee.model.nuisances.recombined import Recombined
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee
from identknee.subject.uncertainty import BONES

# An insertion is not farther off than this, however little is known of it [mm].
FARTHEST = 25.0
PRINCIPAL_AXES = ("1st", "2nd", "3rd")


def insertions(knee: Knee) -> Recombined:
    """Shifts of the insertions whose places are uncertain [mm].

    Along the axes of the bone, or along the principal axes of a covariance that is not the same
    along all of them.
    """
    shifts = insertion(knee)
    columns: list[Array] = []
    names: list[str] = []
    sds: list[float] = []
    places = [(x.name, bone) for x in knee.ligaments for bone in BONES]
    for place, (ligament, bone) in enumerate(places):
        covariance = knee.uncertainty.insertion_covariance(ligament, bone)
        is_diagonal = np.array_equal(covariance, np.diag(np.diag(covariance)))
        squares, directions = (
            (np.diag(covariance), np.eye(3)) if is_diagonal else np.linalg.eigh(covariance)
        )
        axes = AXES if is_diagonal else PRINCIPAL_AXES
        for square, direction, axis in zip(squares, directions.T, axes, strict=True):
            if square > 0.0:
                column = np.zeros(shifts.parameters.n)
                column[3 * place : 3 * place + 3] = direction
                columns.append(column)
                names.append(f"{ligament}_{bone}_{axis}_mm")
                sds.append(float(np.sqrt(square)))
    limits = [min(REACH * x, FARTHEST) for x in sds]
    made = amplitudes(shifts.name, names, sds, upper=limits)
    return Recombined(
        effect=shifts, matrix=np.column_stack(columns), parameters=made.as_nuisances()
    )


def contact_modulus(sd: float) -> SettingChange:
    """Logarithm of the modulus of the cartilage over the knee's own."""
    made = amplitudes("contact_modulus", ["ln_modulus"], [sd], upper=[REACH * sd])
    return SettingChange(name="contact_modulus", parameters=made.as_nuisances(), changed=_stiffened)


def contact_exponent(sd: float) -> SettingChange:
    """Logarithm of the exponent by which contact pressure grows with depth, over the knee's own."""
    made = amplitudes("contact_exponent", ["ln_exponent"], [sd], upper=[REACH * sd])
    return SettingChange(name="contact_exponent", parameters=made.as_nuisances(), changed=_curved)


def toe_region(sd: float) -> SettingChange:
    """Logarithm of the strain at which all ligaments' toe region ends, over the knee's own."""
    made = amplitudes("toe_region", ["ln_strain"], [sd], upper=[REACH * sd])
    return SettingChange(name="toe_region", parameters=made.as_nuisances(), changed=_uncrimped)


def reference_pose(sd_deg: float, sd_mm: float) -> SettingChange:
    """Turn [deg] and shift [mm] of the tibia in the pose in which lengths were measured."""
    names = ["flexion_deg", "varus_deg", "internal_deg", "x_mm", "y_mm", "z_mm"]
    sds = np.array(3 * [sd_deg] + 3 * [sd_mm])
    used = np.flatnonzero(sds)
    made = amplitudes(
        "reference_pose",
        [names[i] for i in used],
        sds[used].tolist(),
        upper=(REACH * sds[used]).tolist(),
    )
    changed = partial(_measured_elsewhere, tuple(used.tolist()))
    return SettingChange(name="reference_pose", parameters=made.as_nuisances(), changed=changed)


def _stiffened(setting: Setting, values: Array) -> Setting:
    law = replace(setting.law, modulus=setting.law.modulus * float(np.exp(values[0])))
    return replace(setting, law=law)


def _curved(setting: Setting, values: Array) -> Setting:
    law = replace(setting.law, exponent=setting.law.exponent * float(np.exp(values[0])))
    return replace(setting, law=law)


def _uncrimped(setting: Setting, values: Array) -> Setting:
    longer = np.where(setting.owner >= 0, float(np.exp(values[0])), 1.0)
    lines = replace(setting.lines, transition=longer * setting.lines.transition)
    return replace(setting, lines=lines)


def _measured_elsewhere(used: tuple[int, ...], setting: Setting, values: Array) -> Setting:
    """The reference lengths that the other pose gives, of the subject's own ligaments."""
    whole = np.zeros(6)
    whole[list(used)] = values
    turn, shift = np.radians(whole[:3]), whole[3:]
    pose = setting.start + np.r_[turn[1:], shift]
    lengths = line_lengths(setting.lines, setting.start_flexion + turn[0], pose)
    change = np.where(setting.owner >= 0, lengths - setting.lengths_at_start(setting.lines), 0.0)
    lines = replace(setting.lines, reference_length=setting.lines.reference_length + change)
    return replace(setting, lines=lines)
