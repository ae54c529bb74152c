"""Rotations of the tibia in the femur and their three angles."""

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import Array


def rotation_matrix(flexion: ArrayLike, varus: ArrayLike, internal: ArrayLike) -> Array:
    """``Rz(-flexion) Rx(varus) Ry(internal)``, angles in rad; shape ``(3, 3, ...)`` of angles."""
    ca, sa = np.cos(flexion), np.sin(flexion)
    cv, sv = np.cos(varus), np.sin(varus)
    ci, si = np.cos(internal), np.sin(internal)
    rotation: Array = np.array(
        [
            [ca * ci + sa * sv * si, sa * cv, ca * si - sa * sv * ci],
            [ca * sv * si - sa * ci, ca * cv, -sa * si - ca * sv * ci],
            [-cv * si, sv, cv * ci],
        ]
    )
    return rotation


def angles_of(rotation: Array) -> tuple[Array, Array, Array]:
    """Flexion, varus and internal rotation [rad] of rotation matrices, shape ``(3, 3, ...)``.

    Examples
    --------
    >>> np.round(angles_of(rotation_matrix(0.5, -0.1, 0.3)), 12)
    array([ 0.5, -0.1,  0.3])
    """
    flexion = np.arctan2(rotation[0, 1], rotation[1, 1])
    varus = np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))
    internal = np.arctan2(-rotation[2, 0], rotation[2, 2])
    return flexion, varus, internal


def start_pose(rotation: Array, translation: Array) -> tuple[float, Array]:
    """Flexion [rad] and pose (varus, internal, x, y, z), shape ``(5,)``, of a rigid displacement.

    ``x_femur = rotation x_tibia + translation``; the pose's translation is in the axes that turn
    with flexion.
    """
    flexion, varus, internal = angles_of(rotation)
    turned = rotation_matrix(flexion, 0.0, 0.0).T @ translation
    return float(flexion), np.array([varus, internal, *turned])
