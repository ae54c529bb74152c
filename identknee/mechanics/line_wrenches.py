"""Wrench of each line on the tibia at many poses at once, with its exact slopes."""

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import line_tensions
from identknee.mechanics.pose import rotation_matrix
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared

NM_PER_NMM = 1e-3


@declared
class LineWrenches:
    """Force of lines on the tibia in tibial axes, and its moment about the tibial origin.

    A twist is a small motion of the tibia: shifts along its axes [mm], then turns about them
    through its origin [rad].
    """

    values: Array = array("Force and moment", "pose", "line", "6", unit="N and N m")
    by_twist: Array = array(
        "Their derivatives by a twist of the tibia",
        *("pose", "line", "6", "6"),
        unit="N and N m per mm or rad",
    )
    by_stiffness: Array = array(
        "Their derivatives by the stiffness of the line", "pose", "line", "6"
    )
    by_strain: Array = array(
        "Their derivatives by the reference strain of the line",
        *("pose", "line", "6"),
        unit="N and N m",
    )


def line_wrenches(
    lines: LineLigaments, flexion: Array, poses: Array, stiffness: Array, reference_strain: Array
) -> LineWrenches:
    """Wrenches of the lines at poses of the tibia.

    Parameters
    ----------
    lines
        Insertions and reference lengths of the m lines.
    flexion
        Flexion of each pose [rad], shape ``(n,)``.
    poses
        Varus, internal [rad], x, y, z [mm] of each, shape ``(n, 5)``.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    rotation = _rotations(poses)
    offset, aside = _in_tibial_axes(lines, flexion, poses, rotation)
    share = np.asarray(lines.wrap_place)[:, None]
    length, gradient, parts = np.zeros(offset.shape[:2]), np.zeros(offset.shape), []
    for part, sign in ((share, -1.0), (1.0 - share, 1.0)):
        course = part * offset + sign * aside
        size = np.linalg.norm(course, axis=2, keepdims=True)
        direction = course / size
        length, gradient = length + size[:, :, 0], gradient + part * direction
        across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
        parts.append((part, sign, direction, across / size[..., None]))
    slack_length = lines.reference_length / (1.0 + reference_strain)
    per_stiffness, slope = line_tensions(
        length / slack_length - 1.0, np.ones(len(stiffness)), lines.transition
    )
    tension, slope = stiffness * per_stiffness, stiffness * slope
    femoral = lines.tibial - offset
    offset_by_twist = np.concatenate(
        [np.broadcast_to(np.eye(3), (*offset.shape, 3)), -_crosses(femoral)], axis=3
    )
    aside_by_twist = np.concatenate([np.zeros((*offset.shape, 3)), _crosses(aside)], axis=3)
    turned = np.zeros(offset_by_twist.shape)
    lengthening = np.zeros((*offset.shape[:2], 6))
    for part, sign, direction, across in parts:
        course_by_twist = part[..., None] * offset_by_twist + sign * aside_by_twist
        lengthening += np.einsum("nmi,nmij->nmj", direction, course_by_twist)
        turned += part[..., None] * (across @ course_by_twist)
    pulled = (slope / slack_length)[:, :, None] * lengthening
    force_by_twist = -gradient[..., None] * pulled[:, :, None] - tension[..., None, None] * turned
    along = _with_moments(lines, -gradient)
    by_strain = slope * length / lines.reference_length
    return LineWrenches(
        values=tension[..., None] * along,
        by_twist=np.swapaxes(_with_moments(lines, np.swapaxes(force_by_twist, 2, 3)), 2, 3),
        by_stiffness=per_stiffness[..., None] * along,
        by_strain=by_strain[..., None] * along,
    )


def twists_by_pose(poses: Array) -> Array:
    """The twist of the tibia [mm, rad] for each coordinate of poses (n, 5), ``(n, 6, 5)``."""
    rotation = _rotations(poses)
    twists = np.zeros((len(poses), 6, 5))
    # A shift along an axis of the femur, and a turn about it, are seen along the tibia's.
    twists[:, :3, 2:] = np.swapaxes(rotation, 1, 2)
    twists[:, 3:, 0] = rotation[:, 0]
    twists[:, 4, 1] = 1.0
    return twists


def _rotations(poses: Array) -> Array:
    return np.moveaxis(rotation_matrix(0.0 * poses[:, 0], poses[:, 0], poses[:, 1]), 2, 0)


def _in_tibial_axes(
    lines: LineLigaments, flexion: Array, poses: Array, rotation: Array
) -> tuple[Array, Array]:
    """From femoral to tibial insertions, and how far lines are pushed aside, ``(n, m, 3)`` each."""
    cos, sin = np.cos(flexion)[:, None], np.sin(flexion)[:, None]
    x, y, z = lines.femoral.T
    femoral = np.stack([cos * x - sin * y, sin * x + cos * y, z + 0.0 * cos], axis=2)
    offset = lines.tibial + (poses[:, None, 2:] - femoral) @ rotation
    return offset, np.asarray(lines.wrap_offset)[:, None] * rotation[:, None, 2]


def _crosses(vectors: Array) -> Array:
    """The matrices (..., 3, 3) that take the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros(x.shape)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _with_moments(lines: LineLigaments, forces: Array) -> Array:
    """Forces (n, m, ..., 3) at the tibial insertions, and their moments about the origin."""
    arms = lines.tibial.reshape(1, -1, *(1,) * (forces.ndim - 3), 3)
    return np.concatenate([forces, NM_PER_NMM * np.cross(arms, forces)], axis=-1)
