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
    force = sums[:, None, :3]
    moment, stiffness, turning, swinging = (
        sums[:, k : k + 9].reshape(-1, 3, 3) for k in (3, 12, 21, 30)
    )
    trace = np.trace(moment, axis1=1, axis2=2)[:, None, None]
    rotation = np.moveaxis(rotation_matrix(flexion, poses[:, 0], poses[:, 1]), 2, 0)
    flexed = np.moveaxis(rotation_matrix(flexion, 0.0 * flexion, 0.0 * flexion), 2, 0)
    origin = (flexed @ poses[:, 2:, None])[:, None, :, 0]
    # Axes of the two rotations and of the three shifts of the pose, one a row.
    about = np.stack([flexed[:, :, 0], rotation[:, :, 1]], axis=1)
    along = np.swapaxes(flexed, 1, 2)

    def columns(turns: Array, shifts: Array, *, is_outer: bool) -> Array:
        """By motions whose turns about the tibial origin and shifts are rows (n, k, 3)."""
        into_turns, into_shifts = np.swapaxes(turns, 1, 2), np.swapaxes(shifts, 1, 2)
        by_turn = about @ (swinging @ into_turns + np.swapaxes(turning, 1, 2) @ into_shifts)
        by_shift = along @ (turning @ into_turns + stiffness @ into_shifts)
        # What turns about an axis that the other motion turns, and pushes that it turns.
        if is_outer:
            by_turn += about @ (moment - trace * np.eye(3)) @ into_turns
            by_shift += along @ np.swapaxes(np.cross(force, turns), 1, 2)
        else:
            by_turn += about @ (np.swapaxes(moment, 1, 2) - trace * np.eye(3)) @ into_turns
            by_turn -= about @ np.swapaxes(np.cross(force, shifts), 1, 2)
        return np.concatenate([by_turn, by_shift], axis=1)

    unit = np.broadcast_to(np.eye(3), flexed.shape)
    none = np.zeros_like(unit)
    own_axes = np.swapaxes(rotation, 1, 2)
    femur = columns(
        np.concatenate([unit, none], axis=1),
        np.concatenate([np.cross(unit, origin), unit], axis=1),
        is_outer=True,
    )
    tibia = columns(
        np.concatenate([own_axes, none], axis=1),
        np.concatenate([none, own_axes], axis=1),
        is_outer=False,
    )
    return np.concatenate([femur, tibia], axis=2)
