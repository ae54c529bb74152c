"""Tensions of line ligaments at many poses at once, with their exact slopes."""

from dataclasses import dataclass

import numpy as np

from identknee.mechanics.equilibria import Lines
from identknee.mechanics.ligament_wrench import line_tensions
from identknee.runs.arrays import Array, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LigamentTensions:
    """Tensions of m ligaments at n poses.

    Attributes
    ----------
    tensions
        [N], shape ``(n, m)``.
    lengthening
        Derivative of each length by varus, internal rotation [mm/rad], x, y and z, ``(n, m, 5)``.
    by_pose
        Derivatives of the tensions by varus, internal rotation [N/rad], x, y and z [N/mm], shape
        ``(n, m, 5)``.
    by_stiffness
        Derivative of each by the stiffness of its own ligament [-], shape ``(n, m)``.
    by_strain
        Derivative of each by the reference strain of its own ligament [N], shape ``(n, m)``.
    """

    tensions: Array
    lengthening: Array
    by_pose: Array
    by_stiffness: Array
    by_strain: Array

    def __post_init__(self) -> None:
        n, m = np.shape(self.tensions)
        for name in ("tensions", "by_stiffness", "by_strain"):
            object.__setattr__(self, name, frozen(getattr(self, name), n, m, name=name))
        for name in ("lengthening", "by_pose"):
            object.__setattr__(self, name, frozen(getattr(self, name), n, m, 5, name=name))

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
        Of each pose [rad], shape ``(n,)``.
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
