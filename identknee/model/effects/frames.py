"""Frames: axes of the bones taken for others than they are, and flexion for another angle."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.mechanics.grood_suntay import coordinates_from_pose, pose_from_coordinates
from identknee.model.effects.changes import ReadingError, SettingChange
from identknee.model.effects.effect import Tests, amplitudes
from identknee.model.setting import Setting
from identknee.runs.arrays import Array

FRAME_SD, FRAME_LIMIT = 2.0, 10.0  # deg


def femur_frame() -> ReadingError:
    """The femur's axes, as the rig has them, turned about their x and y [deg].

    A turn about z is an offset of flexion. Cross-talk of 1 to 5 deg between flexion and the other
    rotations is usual where axes come from landmarks; an estimate.
    """
    made = amplitudes("femur_frame", ["x_deg", "y_deg"], 2 * [FRAME_SD], upper=2 * [FRAME_LIMIT])
    return ReadingError(name="femur_frame", parameters=made, read=_from_turned_femur)


def tibia_frame() -> ReadingError:
    """The tibia's axes, as the rig has them, turned about their x, y and z [deg]."""
    names = ["x_deg", "y_deg", "z_deg"]
    made = amplitudes("tibia_frame", names, 3 * [FRAME_SD], upper=3 * [FRAME_LIMIT])
    return ReadingError(name="tibia_frame", parameters=made, read=_of_turned_tibia)


def flexion_offset() -> SettingChange:
    """How much more the knee was flexed than stated [deg]; 1 to 4 deg is an estimate."""
    made = amplitudes("flexion_offset", ["flexion_deg"], [2.0], upper=[8.0])
    return SettingChange(name="flexion_offset", parameters=made, changed=_flexed)


def _from_turned_femur(coordinates: Array, values: Array, tests: Tests) -> Array:
    turned = Rotation.from_rotvec(np.radians([values[0], values[1], 0.0]))
    return _read(coordinates, tests, turned, Rotation.identity())


def _of_turned_tibia(coordinates: Array, values: Array, tests: Tests) -> Array:
    return _read(coordinates, tests, Rotation.identity(), Rotation.from_rotvec(np.radians(values)))


def _read(coordinates: Array, tests: Tests, femur: Rotation, tibia: Rotation) -> Array:
    """Coordinates between frames turned from the true ones, their origins where they are.

    The tibial origin is the same point, but its components are those along the axes that the rig
    has: femoral z, tibial y and the perpendicular to both.
    """
    pose = pose_from_coordinates(coordinates)
    flexion = np.radians(tests.protocol.flexion_deg)
    actual = Rotation.from_euler("ZXY", np.column_stack([-flexion, pose[:, 0], pose[:, 1]]))
    origin = Rotation.from_euler("z", -flexion[:, None]).apply(pose[:, 2:])
    angles = (femur.inv() * actual * tibia).as_euler("ZXY")
    in_turned_axes = Rotation.from_euler("z", -angles[:, :1]).apply(femur.inv().apply(origin))
    return coordinates_from_pose(np.column_stack([angles[:, 1:], in_turned_axes]))


def _flexed(setting: Setting, values: Array) -> Setting:
    return replace(setting, flexion=setting.flexion + np.radians(values[0]))
