"""What a small motion of the contact surfaces, the ligaments at rest, does to the gradient."""

import numpy as np

from identknee.mechanics.pose import rotation_matrix
from identknee.runs.arrays import Array


def contact_motion_columns(sums: Array, flexion: Array, poses: Array) -> Array:
    """Derivatives of the energy's gradient by small motions of the surfaces, ``(n, 5, 12)``.

    Parameters
    ----------
    sums
        Those over the contact elements at each pose, as
        `identknee.mechanics.elements.write_sums` writes them, shape ``(n, 39)``.
    flexion
        [rad], shape ``(n,)``.
    poses
        Shape ``(n, 5)``.

    Returns
    -------
    columns
        By a rotation [rad] about and a shift [mm] along the axes of the femoral frame, of places
        within the femur's surface; then about and along those of the tibial frame, of the tibia's
        surface.
    """
    moment, stiffness, turning, swinging = (
        sums[:, k : k + 9].reshape(-1, 3, 3) for k in (3, 12, 21, 30)
    )
    pushing = _crossing(sums[:, :3])
    trace = np.trace(moment, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    rotation = np.moveaxis(rotation_matrix(flexion, poses[:, 0], poses[:, 1]), 2, 0)
    flexed = np.moveaxis(rotation_matrix(flexion, 0.0 * flexion, 0.0 * flexion), 2, 0)
    # Axes of the two rotations and of the three shifts of the pose, one a row.
    about = np.stack([flexed[:, :, 0], rotation[:, :, 1]], axis=1)
    along = np.swapaxes(flexed, 1, 2)
    # A turn of the femur is one about the tibial origin and a shift of that.
    lever = _crossing((flexed @ poses[:, 2:, None])[:, :, 0])
    swapped = np.swapaxes(turning, 1, 2)
    carried = np.stack([swapped, stiffness], axis=1) @ lever[:, None]
    # The outer of two turns turns the axis of the other, and pushes that the other turns.
    moments_by_turn = swinging + moment - trace - carried[:, 0]
    forces_by_turn = turning + pushing - carried[:, 1]
    inner = np.stack(
        [swinging + np.swapaxes(moment, 1, 2) - trace, swapped - pushing, turning, stiffness],
        axis=1,
    )
    own = inner @ rotation[:, None]
    moments = np.concatenate([moments_by_turn, swapped, own[:, 0], own[:, 1]], axis=2)
    forces = np.concatenate([forces_by_turn, stiffness, own[:, 2], own[:, 3]], axis=2)
    return np.concatenate([about @ moments, along @ forces], axis=1)


def _crossing(vectors: Array) -> Array:
    """Matrices (n, 3, 3) that take the cross product of each of `vectors` (n, 3) with another."""
    x, y, z = vectors.T
    none = np.zeros(len(vectors))
    rows = np.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    return np.asarray(np.moveaxis(rows, 2, 0))
