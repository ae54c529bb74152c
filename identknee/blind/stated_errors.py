"""What is given with a knee and its tests, drawn as wrong as it is stated to be."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.blind.conditions import Conditions
from identknee.blind.experiment import Experiment
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee

GAINS = tuple(
    f"load_gain.{x}"
    for x in ("varus_moment", "internal_moment", "anterior_force", "axial_force", "lateral_force")
)
# Of a difference of two places [mm] or frames [deg] that are the same.
ROUNDING = 1e-9


def actual_knee(knee: Knee, conditions: Conditions, generator: np.random.Generator) -> Knee:
    """The knee as it is in the rig, where the one given has errors of the stated size.

    Insertions lie elsewhere, with reference lengths measured between them in the scanned pose; and
    the frames that the rig works with are others than those given, so that loads, flexion and
    readings all belong to them.
    """
    shifts = conditions.insertion_mm * generator.standard_normal((len(knee.ligaments), 2, 3))
    femur, tibia = (
        _moved(frame, conditions, generator) for frame in (knee.femur_frame, knee.tibia_frame)
    )
    ligaments = [
        replace(
            ligament,
            femur=ligament.femur + femoral @ knee.femur_frame.axes,
            tibia=ligament.tibia + tibial @ knee.tibia_frame.axes,
        )
        for ligament, (femoral, tibial) in zip(knee.ligaments, shifts, strict=True)
    ]
    return replace(knee, ligaments=tuple(ligaments), femur_frame=femur, tibia_frame=tibia)


@declared
class LoadErrors:
    """What the loads that act differ by from those stated."""

    gains: Array = entry("Scale of each kind of load less 1, shape ``(5,)``")
    turn_deg: Array = entry("Turn of their axes [deg], shape ``(3,)``")


NO_ERRORS = LoadErrors(gains=np.zeros(5), turn_deg=np.zeros(3))


def drawn_wrong(
    knee: Knee, conditions: Conditions, generator: np.random.Generator
) -> tuple[Knee, LoadErrors]:
    """The knee as it is in the rig, and what the loads are off by."""
    return actual_knee(knee, conditions, generator), load_errors(conditions, generator)


def load_errors(conditions: Conditions, generator: np.random.Generator) -> LoadErrors:
    """Errors of the loads, of the stated size."""
    gains = conditions.load_gain * generator.standard_normal(5)
    turn_deg = conditions.load_axes_deg * generator.standard_normal(3)
    return LoadErrors(gains=gains, turn_deg=turn_deg)


def with_load_errors(experiment: Experiment, errors: LoadErrors) -> Experiment:
    """The experiment with loads along turned axes, each kind of a size of its own."""
    turn = Rotation.from_rotvec(np.radians(errors.turn_deg)).as_matrix()
    # Varus about the anterior axis, internal about the superior one; distraction points down.
    loads = experiment.loads * (1.0 + errors.gains)
    moments = np.column_stack([loads[:, 0], loads[:, 1], np.zeros(len(loads))]) @ turn.T
    forces = np.column_stack([loads[:, 2], -loads[:, 3], loads[:, 4]]) @ turn.T
    acting = np.column_stack(
        [moments[:, 0], moments[:, 1], forces[:, 0], -forces[:, 1], forces[:, 2]]
    )
    return replace(experiment, loads=acting)


def true_errors(given: Knee, actual: Knee, loads: LoadErrors) -> dict[str, float]:
    """Every error that is not zero, by the name of the nuisance that stands for it."""
    found: dict[str, Array] = {}
    for before, after in zip(given.ligaments, actual.ligaments, strict=True):
        name = f"insertion.{before.name}"
        found[f"{name}_femur_{{}}_mm"] = given.femur_frame.axes @ (after.femur - before.femur)
        found[f"{name}_tibia_{{}}_mm"] = given.tibia_frame.axes @ (after.tibia - before.tibia)
    frames = {
        "femur": (given.femur_frame, actual.femur_frame),
        "tibia": (given.tibia_frame, actual.tibia_frame),
    }
    for bone, (stated, own) in frames.items():
        turn = Rotation.from_matrix(stated.axes @ own.axes.T).as_rotvec(degrees=True)
        found[f"registration.{bone}_{{}}_deg"] = turn
        found[f"registration.{bone}_{{}}_mm"] = stated.to_local(own.origin)
    found["load_axes.{}_deg"] = loads.turn_deg
    numbers = {
        name.format(axis): float(x)
        for name, values in found.items()
        for axis, x in zip("xyz", values, strict=True)
    }
    numbers |= dict(zip(GAINS, loads.gains.tolist(), strict=True))
    return {name: x for name, x in numbers.items() if abs(x) > ROUNDING}


def _moved(frame: Frame, conditions: Conditions, generator: np.random.Generator) -> Frame:
    turn = np.radians(conditions.registration_deg) * generator.standard_normal(3)
    shift: Array = conditions.registration_mm * generator.standard_normal(3)
    axes = Rotation.from_rotvec(turn).as_matrix().T @ frame.axes
    return Frame(origin=frame.to_common(shift), axes=axes)
