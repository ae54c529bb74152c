"""Joint coordinates of the knee: their conversion from and to the pose the kernel solves for.

The columns of coordinates are, in this order, lateral shift, anterior drawer, distraction [mm],
varus and internal rotation [deg]; those of poses varus, internal rotation [rad] and x, y, z [mm],
the tibial origin in femoral axes that turn with flexion.
"""

import numpy as np

from identknee.runs.arrays import Array


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
