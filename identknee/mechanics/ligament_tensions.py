"""Tensions of line ligaments at many poses at once, with their exact slopes."""

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.mechanics.ligament_wrench import line_tensions
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared


@declared
class LigamentTensions:
    """Tensions of ligaments at poses, with their derivatives.

    The five coordinates are varus, internal rotation, x, y and z.
    """

    tensions: Array = array("Tensions", "pose", "ligament", unit="N")
    lengthening: Array = array(
        "Derivatives of the lengths by the coordinates",
        *("pose", "ligament", "freedom"),
        unit="mm/rad or mm/mm",
    )
    by_pose: Array = array(
        "Derivatives of the tensions by the coordinates",
        *("pose", "ligament", "freedom"),
        unit="N/rad or N/mm",
    )
    by_stiffness: Array = array(
        "Derivatives of the tensions by the stiffness of the own ligament", "pose", "ligament"
    )
    by_strain: Array = array(
        "Derivatives of the tensions by the reference strain of the own ligament",
        *("pose", "ligament"),
        unit="N",
    )

    @property
    def gradient(self) -> Array:
        """Gradient of the ligaments' energy by the pose [N mm, N], shape ``(n, 5)``."""
        gradient: Array = np.einsum("nm,nma->na", self.tensions, self.lengthening)
        return gradient


def ligament_tensions(
    lines: Lines, flexion: Array, poses: Array, stiffness: Array, reference_strain: Array
) -> LigamentTensions:
    """Tensions of the ligaments at poses of the tibia.

    Parameters
    ----------
    lines
        Insertions and reference lengths of the m ligaments.
    flexion
        Flexion of each pose [rad], shape ``(n,)``.
    poses
        Varus, internal [rad], x, y, z [mm] of each, shape ``(n, 5)``.
    stiffness
        [N per unit strain], shape ``(m,)``.
    reference_strain
        Strain at the reference length [-], shape ``(m,)``.
    """
    length, lengthening = _lengths(lines, flexion, poses)
    slack_length = lines.reference_length / (1.0 + reference_strain)
    # The law is asked for unit stiffness, since stiffness zero has a slope by stiffness as well.
    per_stiffness, slope = line_tensions(
        length / slack_length - 1.0, np.ones(len(stiffness)), lines.transition
    )
    return LigamentTensions(
        tensions=stiffness * per_stiffness,
        lengthening=lengthening,
        by_pose=(stiffness * slope / slack_length)[:, :, None] * lengthening,
        by_stiffness=per_stiffness,
        by_strain=stiffness * slope * length / lines.reference_length,
    )


def line_gradients(
    lines: Lines, flexion: Array, poses: Array, stiffness: Array, reference_strain: Array
) -> Array:
    """Gradient of each line's energy by the pose [N mm, N], shape ``(n, m, 5)``.

    Parameters are those of `ligament_tensions`.
    """
    length, lengthening = _lengths(lines, flexion, poses)
    slack_length = lines.reference_length / (1.0 + reference_strain)
    tensions, _ = line_tensions(length / slack_length - 1.0, stiffness, lines.transition)
    return np.asarray(tensions[:, :, None] * lengthening)


def line_lengths(lines: Lines, flexion: float, pose: Array) -> Array:
    """Lengths of the lines [mm], shape ``(m,)``, at `flexion` [rad] and a `pose` (5,)."""
    offset, _, _ = _offsets(lines, np.array([flexion]), pose[None])
    length, _ = _course(lines, offset)
    return length.reshape(-1)


def _lengths(lines: Lines, flexion: Array, poses: Array) -> tuple[Array, Array]:
    """Lengths [mm], (n, m), and their derivatives by the poses [mm/rad, mm/mm], (n, m, 5)."""
    offset, tibial, turned_z = _offsets(lines, flexion, poses)
    length, (x, y, z) = _course(lines, offset)
    sin, cos = np.sin(poses[:, :1]), np.cos(poses[:, :1])
    by_varus = tibial[1] * z - tibial[2] * y
    by_internal = turned_z * x + tibial[0] * (sin * y - cos * z)
    return length, np.stack([by_varus, by_internal, x, y, z], axis=2)


def _course(lines: Lines, offset: Array) -> tuple[Array, Array]:
    """Length of each line and its gradient by `offset` (3, n, m), pushed aside where it is."""
    place, offset_z = np.asarray(lines.wrap_place), np.asarray(lines.wrap_offset)
    if not offset_z.any():
        length = np.sqrt((offset**2).sum(axis=0))
        return length, offset / length
    length, direction = np.zeros(offset.shape[1:]), np.zeros(offset.shape)
    for share, aside in ((place, -offset_z), (1.0 - place, offset_z)):
        part = share * offset
        part[2] += aside
        size = np.sqrt((part**2).sum(axis=0))
        length += size
        direction += share * part / size
    return length, direction


def _offsets(lines: Lines, flexion: Array, poses: Array) -> tuple[Array, Array, Array]:
    """From femoral to tibial insertions [mm], (3, n, m), the latter, and their z before varus.

    In femoral axes turned with flexion, where the translation of a pose stands as it is; tibial
    insertions are turned and not shifted.
    """
    ca, sa = np.cos(flexion)[:, None], np.sin(flexion)[:, None]
    cv, sv = np.cos(poses[:, :1]), np.sin(poses[:, :1])
    ci, si = np.cos(poses[:, 1:2]), np.sin(poses[:, 1:2])
    x, y, z = lines.tibial.T
    turned_z = ci * z - si * x
    tibial = np.stack([ci * x + si * z, cv * y - sv * turned_z, sv * y + cv * turned_z])
    x, y, z = lines.femoral.T
    offset = tibial + poses[:, 2:].T[:, :, None]
    offset[0] -= ca * x - sa * y
    offset[1] -= sa * x + ca * y
    offset[2] -= z
    return offset, tibial, turned_z
