"""What is given with a knee and its tests, drawn as wrong as it is stated to be."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.blind.conditions import Conditions
from identknee.blind.experiment import Experiment
from identknee.runs.arrays import Array
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee


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


def with_load_errors(
    experiment: Experiment, conditions: Conditions, generator: np.random.Generator
) -> Experiment:
    """The experiment with loads along turned axes, each kind of a size of its own."""
    gains = 1.0 + conditions.load_gain * generator.standard_normal(5)
    turn = Rotation.from_rotvec(
        np.radians(conditions.load_axes_deg) * generator.standard_normal(3)
    ).as_matrix()
    # Varus about the anterior axis, internal about the superior one; distraction points down.
    loads = experiment.loads * gains
    moments = np.column_stack([loads[:, 0], loads[:, 1], np.zeros(len(loads))]) @ turn.T
    forces = np.column_stack([loads[:, 2], -loads[:, 3], loads[:, 4]]) @ turn.T
    acting = np.column_stack(
        [moments[:, 0], moments[:, 1], forces[:, 0], -forces[:, 1], forces[:, 2]]
    )
    return replace(experiment, loads=acting)


def _moved(frame: Frame, conditions: Conditions, generator: np.random.Generator) -> Frame:
    turn = np.radians(conditions.registration_deg) * generator.standard_normal(3)
    shift: Array = conditions.registration_mm * generator.standard_normal(3)
    axes = Rotation.from_rotvec(turn).as_matrix().T @ frame.axes
    return Frame(origin=frame.to_common(shift), axes=axes)
