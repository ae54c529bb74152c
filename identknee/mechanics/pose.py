"""Rotation of the tibia in the femur and its three angles."""

import numpy as np

from identknee.runs.arrays import Array


def rotation_matrix(flexion: float, varus: float, internal: float) -> Array:
    """``Rz(-flexion) Rx(varus) Ry(internal)``, angles in rad; shape ``(3, 3)``."""
    ca, sa = np.cos(flexion), np.sin(flexion)
    cv, sv = np.cos(varus), np.sin(varus)
    ci, si = np.cos(internal), np.sin(internal)
    about_z = np.array([[ca, sa, 0.0], [-sa, ca, 0.0], [0.0, 0.0, 1.0]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cv, -sv], [0.0, sv, cv]])
    about_y = np.array([[ci, 0.0, si], [0.0, 1.0, 0.0], [-si, 0.0, ci]])
    rotation: Array = about_z @ about_x @ about_y
    return rotation


def angles_of(rotation: Array) -> tuple[float, float, float]:
    """Flexion, varus and internal rotation [rad] of a rotation matrix.

    Examples
    --------
    >>> np.round(angles_of(rotation_matrix(0.5, -0.1, 0.3)), 12)
    array([ 0.5, -0.1,  0.3])
    """
    flexion = np.arctan2(rotation[0, 1], rotation[1, 1])
    varus = np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))
    internal = np.arctan2(-rotation[2, 0], rotation[2, 2])
    return float(flexion), float(varus), float(internal)


def start_pose(rotation: Array, translation: Array) -> tuple[float, Array]:
    """Flexion [rad] and pose (varus, internal, x, y, z), shape ``(5,)``, of a rigid displacement.

    ``x_femur = rotation x_tibia + translation``; the pose's translation is in the axes that turn
    with flexion.
    """
    flexion, varus, internal = angles_of(rotation)
    turned = rotation_matrix(flexion, 0.0, 0.0).T @ translation
    return flexion, np.array([varus, internal, *turned])
