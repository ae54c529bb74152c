"""Poses of the tibia in the femur: rotations, their three angles, and joint coordinates.

The columns of coordinates are, in this order, lateral shift, anterior drawer, distraction [mm],
varus and internal rotation [deg]; those of poses varus, internal rotation [rad] and x, y, z [mm],
the tibial origin in femoral axes that turn with flexion.
"""

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.declare import Array, IntArray, declared, entry


def rotation_matrix(flexion: ArrayLike, varus: ArrayLike, internal: ArrayLike) -> Array:
    """``Rz(-flexion) Rx(varus) Ry(internal)``, angles in rad; shape ``(3, 3, ...)`` of angles."""
    ca, sa = np.cos(flexion), np.sin(flexion)
    cv, sv = np.cos(varus), np.sin(varus)
    ci, si = np.cos(internal), np.sin(internal)
    return np.asarray(
        np.array(
            [
                [ca * ci + sa * sv * si, sa * cv, ca * si - sa * sv * ci],
                [ca * sv * si - sa * ci, ca * cv, -sa * si - ca * sv * ci],
                [-cv * si, sv, cv * ci],
            ]
        )
    )


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


_ABOUT_X = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_ABOUT_Y = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])


@declared
class Placement:
    """A rigid displacement ``x_femur = rotation x_tibia + translation`` and how it varies.

    Or n of them, with n as the first length of all arrays.
    """

    rotation: Array = entry("``Rz(-flexion) Rx(varus) Ry(internal)``, shape ``(..., 3, 3)``")
    translation: Array = entry("Tibial origin in femoral axes [mm], shape ``(..., 3)``")
    turns: tuple[Array, Array, Array] = entry(
        "The rotations by flexion, varus and internal rotation, shape ``(..., 3, 3)`` each"
    )

    @property
    def first(self) -> Array:
        """Derivatives of the rotation by varus and internal rotation, ``(..., 2, 3, 3)``."""
        flexed, about_x, about_y = self.turns
        # A turn about a fixed axis differentiates to the axis' cross product times the turn.
        by_varus = flexed @ _ABOUT_X @ about_x @ about_y
        return np.stack([by_varus, flexed @ about_x @ _ABOUT_Y @ about_y], axis=-3)

    @property
    def second(self) -> Array:
        """Its second derivatives by varus, varus; varus, internal; internal, internal.

        The shape is ``(..., 3, 3, 3)``.
        """
        flexed, about_x, about_y = self.turns
        return np.stack(
            [
                flexed @ _ABOUT_X @ _ABOUT_X @ about_x @ about_y,
                flexed @ _ABOUT_X @ about_x @ _ABOUT_Y @ about_y,
                flexed @ about_x @ _ABOUT_Y @ _ABOUT_Y @ about_y,
            ],
            axis=-3,
        )

    @property
    def axes(self) -> Array:
        """Derivatives of the translation by x, y and z, one a row, shape ``(..., 3, 3)``."""
        return np.asarray(np.swapaxes(self.turns[0], -1, -2))

    def to_femur(self, points: Array) -> Array:
        """Tibial `points` (k, 3) [mm] in femoral axes, ``(k, 3)`` or ``(n, k, 3)``."""
        turned = points @ np.swapaxes(self.rotation, -1, -2)
        return np.asarray(turned + self.translation[..., None, :])

    def to_tibia(self, points: Array) -> Array:
        """Femoral `points` (k, 3) [mm] in tibial axes."""
        return np.asarray((points - self.translation[..., None, :]) @ self.rotation)

    def jacobian(self, points: Array, pose: IntArray | None = None) -> Array:
        """Derivatives of the femoral position of tibial `points` (k, 3), shape ``(k, 5, 3)``.

        Of n displacements `pose` says which is that of each point, shape ``(k,)``.
        """
        first, axes = self.first, self.axes
        if pose is not None:
            first, axes = first[pose], axes[pose]
        turned = np.einsum("...aij,...j->...ai", first, points)
        return np.concatenate([turned, np.broadcast_to(axes, (len(points), 3, 3))], axis=1)

    def bending(self, points: Array, forces: Array) -> Array:
        """Second derivative of ``sum forces . position`` of tibial `points`, shape ``(5, 5)``."""
        work = np.einsum("kij,nj,ni->k", self.second, points, forces)
        bending = np.zeros((5, 5))
        bending[0, 0], bending[1, 1] = work[0], work[2]
        bending[0, 1] = bending[1, 0] = work[1]
        return bending


def place(flexion: ArrayLike, pose: Array) -> Placement:
    """The placement at `flexion` [rad] and `pose`: varus, internal [rad], x, y, z [mm].

    Those of n poses with flexion ``(n,)`` and pose ``(n, 5)``.

    Examples
    --------
    >>> placement = place(0.5, np.array([0.0, 0.0, 1.0, 2.0, 3.0]))
    >>> placement.to_tibia(placement.to_femur(np.array([[4.0, 5.0, 6.0]]))).round(12)
    array([[4., 5., 6.]])
    """
    varus, internal = pose[..., 0], pose[..., 1]
    none = np.zeros_like(varus)
    flexed = _turns(flexion, none, none)
    about_x, about_y = _turns(none, varus, none), _turns(none, none, internal)
    return Placement(
        rotation=flexed @ about_x @ about_y,
        translation=(flexed @ pose[..., 2:, None])[..., 0],
        turns=(flexed, about_x, about_y),
    )


def _turns(flexion: ArrayLike, varus: ArrayLike, internal: ArrayLike) -> Array:
    """Rotation matrices, shape ``(..., 3, 3)``."""
    return np.moveaxis(rotation_matrix(flexion, varus, internal), (0, 1), (-2, -1))


def coordinates_from_pose(pose: Array) -> Array:
    """Joint coordinates of poses.

    The tibial origin is split into components along the oblique axes of the joint: e1 (femoral,
    lateral), e2 (floating, anterior) and e3 (tibial, superior), as
    ``lateral_shift e1 + anterior_drawer e2 - distraction e3``. None of it depends on flexion.

    Parameters
    ----------
    pose
        Varus, internal [rad], x, y, z [mm], shape ``(..., 5)``.

    Returns
    -------
    coordinates
        Lateral shift, anterior drawer, distraction [mm], varus, internal [deg], ``(..., 5)``.

    References
    ----------
    .. [1] Grood and Suntay (1983), J. Biomech. Eng. 105(2), 136-144.
           https://doi.org/10.1115/1.3138397

    Examples
    --------
    >>> coordinates_from_pose(np.array([0.0, 0.0, 1.0, -2.0, 3.0])).tolist()
    [3.0, 1.0, 2.0, 0.0, 0.0]
    """
    pose = np.asarray(pose, float)
    varus, y = pose[..., 0], pose[..., 3]
    coordinates = np.empty_like(pose)
    coordinates[..., 0] = pose[..., 4] - y * np.tan(varus)
    coordinates[..., 1] = pose[..., 2]
    coordinates[..., 2] = -y / np.cos(varus)
    coordinates[..., 3:] = np.degrees(pose[..., :2])
    return coordinates


def pose_from_coordinates(coordinates: Array) -> Array:
    """Poses of joint coordinates: the inverse of `coordinates_from_pose`.

    Parameters
    ----------
    coordinates
        Lateral shift, anterior drawer, distraction [mm], varus, internal [deg], ``(..., 5)``.

    Returns
    -------
    pose
        Varus, internal [rad], x, y, z [mm], shape ``(..., 5)``.

    Examples
    --------
    >>> pose_from_coordinates(np.array([3.0, 1.0, 2.0, 0.0, 0.0])).tolist()
    [0.0, 0.0, 1.0, -2.0, 3.0]
    """
    shift, drawer, distraction, varus_deg, internal_deg = np.moveaxis(
        np.asarray(coordinates, float), -1, 0
    )
    varus = np.radians(varus_deg)
    return np.stack(
        [
            varus,
            np.radians(internal_deg),
            drawer,
            -distraction * np.cos(varus),
            shift - distraction * np.sin(varus),
        ],
        axis=-1,
    )


def coordinate_jacobian(pose: Array) -> Array:
    """Derivative of the joint coordinates with respect to the pose, shape ``(..., 5, 5)``.

    Parameters
    ----------
    pose
        Varus, internal [rad], x, y, z [mm], shape ``(..., 5)``.
    """
    varus, y = pose[..., 0], pose[..., 3]
    secant, tangent = 1.0 / np.cos(varus), np.tan(varus)
    jacobian = np.zeros((*varus.shape, 5, 5))
    jacobian[..., 0, 0] = -y * secant**2
    jacobian[..., 0, 3] = -tangent
    jacobian[..., 0, 4] = 1.0
    jacobian[..., 1, 2] = 1.0
    jacobian[..., 2, 0] = -y * secant * tangent
    jacobian[..., 2, 3] = -secant
    jacobian[..., 3, 0] = jacobian[..., 4, 1] = np.degrees(1.0)
    return jacobian
