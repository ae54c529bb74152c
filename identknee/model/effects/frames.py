"""Misaligned anatomical frames, and offset flexion."""

from dataclasses import replace

import numpy as np

from identknee.mechanics.grood_suntay import coordinates_from_pose, pose_from_coordinates
from identknee.mechanics.pose import angles_of, rotation_matrix
from identknee.model.effects.effect import (
    InputsChange,
    ReplicaReadingError,
    TrialRecord,
    amplitudes,
)
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.runs.arrays import Array

FRAME_SD, FRAME_LIMIT = 2.0, 10.0  # deg


def femur_frame() -> ReplicaReadingError:
    """The femur's axes, as the rig has them, turned about their x and y [deg].

    A turn about z is an offset of flexion. Cross-talk of 1 to 5 deg between flexion and the other
    rotations is usual where axes come from landmarks; an estimate.
    """
    made = amplitudes("femur_frame", ["x_deg", "y_deg"], 2 * [FRAME_SD], upper=2 * [FRAME_LIMIT])
    return ReplicaReadingError(name="femur_frame", parameters=made, read=_from_turned_femur)


def tibia_frame() -> ReplicaReadingError:
    """The tibia's axes, as the rig has them, turned about their x, y and z [deg]."""
    names = ["x_deg", "y_deg", "z_deg"]
    made = amplitudes("tibia_frame", names, 3 * [FRAME_SD], upper=3 * [FRAME_LIMIT])
    return ReplicaReadingError(name="tibia_frame", parameters=made, read=_of_turned_tibia)


def flexion_offset() -> InputsChange:
    """How much more the knee was flexed than stated [deg]; 1 to 4 deg is an estimate."""
    made = amplitudes("flexion_offset", ["flexion_deg"], [2.0], upper=[8.0])
    return InputsChange(name="flexion_offset", parameters=made, changed=_flexed)


def _from_turned_femur(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    about_x_y = np.concatenate([values, np.zeros((*values.shape[:-1], 1))], axis=-1)
    return _read(coordinates, tests, _turns(about_x_y), _turns(np.zeros(3)))


def _of_turned_tibia(coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    return _read(coordinates, tests, _turns(np.zeros(3)), _turns(values))


def _turns(values: Array) -> Array:
    """Rotation matrices of vectors (3,) or (k, 3) [deg], shape ``(3, 3, k)``."""
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(np.radians(np.atleast_2d(values))).as_matrix()
    return np.asarray(np.moveaxis(turns, 0, 2))


def _read(coordinates: Array, tests: TrialRecord, femur: Array, tibia: Array) -> Array:
    """Coordinates between frames turned from the true ones, their origins where they are.

    The tibial origin is the same point, but its components are those along the axes that the rig
    has: femoral z, tibial y and the perpendicular to both. The turns, shape ``(3, 3, k)``, are
    those of k equal parts of the coordinates.
    """
    n = len(coordinates)
    femur, tibia = (np.repeat(x, n // x.shape[2], axis=2) for x in (femur, tibia))
    pose, flexion = pose_from_coordinates(coordinates), np.radians(tests.flexion_deg)
    actual = rotation_matrix(flexion, pose[:, 0], pose[:, 1])
    turned = np.einsum("ikn,kln->iln", np.einsum("jin,jkn->ikn", femur, actual), tibia)
    read_flexion, varus, internal = angles_of(turned)
    none = np.zeros(n)
    origin = np.einsum("ikn,nk->in", rotation_matrix(flexion, none, none), pose[:, 2:])
    origin = np.einsum("jin,jn->in", femur, origin)
    in_turned_axes = np.einsum("jin,jn->in", rotation_matrix(read_flexion, none, none), origin)
    return coordinates_from_pose(np.column_stack([varus, internal, *in_turned_axes]))


def _flexed(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    return replace(setting, flexion=setting.flexion + np.radians(values[0]))
