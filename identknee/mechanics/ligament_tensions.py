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
    offset, by_varus, by_internal = _offsets(lines, flexion, poses)
    length, direction = _course(lines, offset)
    slack_length = lines.reference_length / (1.0 + reference_strain)
    # The law is asked for unit stiffness, since stiffness zero has a slope by stiffness as well.
    per_stiffness, slope = line_tensions(
        length / slack_length - 1.0, np.ones(len(stiffness)), lines.transition
    )
    lengthening = np.concatenate(
        [
            np.einsum("nmi,nmi->nm", by_varus, direction)[:, :, None],
            np.einsum("nmi,nmi->nm", by_internal, direction)[:, :, None],
            direction,
        ],
        axis=2,
    )
    return LigamentTensions(
        tensions=stiffness * per_stiffness,
        lengthening=lengthening,
        by_pose=(stiffness * slope / slack_length)[:, :, None] * lengthening,
        by_stiffness=per_stiffness,
        by_strain=stiffness * slope * length / lines.reference_length,
    )


def line_lengths(lines: Lines, flexion: float, pose: Array) -> Array:
    """Lengths of the lines [mm], shape ``(m,)``, at `flexion` [rad] and a `pose` (5,)."""
    offset, _, _ = _offsets(lines, np.array([flexion]), pose[None])
    length, _ = _course(lines, offset)
    return length.reshape(-1)


def _course(lines: Lines, offset: Array) -> tuple[Array, Array]:
    """Length of each line and its gradient by `offset` (n, m, 3), pushed aside where it is."""
    length, direction = np.zeros(offset.shape[:2]), np.zeros(offset.shape)
    place, offset_z = np.asarray(lines.wrap_place), np.asarray(lines.wrap_offset)
    for share, aside in ((place, -offset_z), (1.0 - place, offset_z)):
        part = share[:, None] * offset
        part[:, :, 2] += aside
        size = np.linalg.norm(part, axis=2)
        length += size
        direction += share[:, None] * part / size[:, :, None]
    return length, direction


def _offsets(lines: Lines, flexion: Array, poses: Array) -> tuple[Array, Array, Array]:
    """From femoral to tibial insertions [mm], (n, m, 3), and their slopes by the two angles [mm].

    In femoral axes turned with flexion, where the translation of a pose stands as it is.
    """
    ca, sa = np.cos(flexion)[:, None], np.sin(flexion)[:, None]
    cv, sv = np.cos(poses[:, :1]), np.sin(poses[:, :1])
    ci, si = np.cos(poses[:, 1:2]), np.sin(poses[:, 1:2])
    x, y, z = lines.femoral.T
    femoral = np.stack([ca * x - sa * y, sa * x + ca * y, z + 0.0 * ca], axis=2)
    x, y, z = lines.tibial.T
    turned_x, turned_z = ci * x + si * z, ci * z - si * x
    tibial = np.stack([turned_x, cv * y - sv * turned_z, sv * y + cv * turned_z], axis=2)
    by_varus = np.stack([0.0 * turned_x, -tibial[:, :, 2], tibial[:, :, 1]], axis=2)
    by_internal = np.stack([turned_z, sv * turned_x, -cv * turned_x], axis=2)
    return tibial + poses[:, None, 2:] - femoral, by_varus, by_internal
