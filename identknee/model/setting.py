"""What the laxity model hands to the mechanics, before and after effects have changed it."""

from dataclasses import dataclass, replace

import numpy as np

from identknee.mechanics.equilibria import ContactLaw, Lines
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.runs.arrays import Array, IntArray

# Units of the mechanics per unit of a parameter: N per kN, strain per %.
PER_KN, PER_PCT = 1000.0, 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """Loads, angles, lines and contact at the nodes of the load paths.

    Attributes
    ----------
    flexion
        Flexion of each node [rad], shape ``(n,)``.
    loads
        Generalised loads of (varus, internal [N mm], x, y, z [N]), shape ``(n, 5)``: x anterior,
        y superior and z lateral, in the axes of the femur turned with flexion.
    lines
        All lines: the subject's ligaments first, in their order.
    stiffness
        Stiffness of each line [N per unit strain], shape ``(m,)``.
    reference_strain
        Reference strain of each line [-], shape ``(m,)``.
    owner
        Which ligament's calibrated stiffness and reference strain a line takes part in, -1 for
        none, shape ``(m,)``.
    share
        Share of its owner's stiffness, shape ``(m,)``.
    law
        The contact law.
    start_flexion, start
        The scanned pose: flexion [rad] and (varus, internal [rad], x, y, z [mm]), ``(5,)``.
    """

    flexion: Array
    loads: Array
    lines: Lines
    stiffness: Array
    reference_strain: Array
    owner: IntArray
    share: Array
    law: ContactLaw
    start_flexion: float
    start: Array

    def owned(self, n_ligaments: int) -> Array:
        """Which line belongs to which ligament, 1 or 0, shape ``(m, n_ligaments)``."""
        owned: Array = (self.owner[:, None] == np.arange(n_ligaments)).astype(float)
        return owned

    def lengths_at_start(self, lines: Lines) -> Array:
        """Lengths of lines in the scanned pose [mm], shape ``(m,)``."""
        return line_lengths(lines, self.start_flexion, self.start)


def with_lines(
    setting: Setting, added: Lines, stiffness: Array, reference_strain: Array
) -> Setting:
    """The setting with lines added that belong to none of the subject's ligaments."""
    lines, none = setting.lines, np.full(len(added.femoral), -1)
    return replace(
        setting,
        lines=Lines(
            femoral=np.vstack([lines.femoral, added.femoral]),
            tibial=np.vstack([lines.tibial, added.tibial]),
            reference_length=np.r_[lines.reference_length, added.reference_length],
            transition=np.r_[lines.transition, added.transition],
            wrap_offset=np.r_[lines.wrap_offset, added.wrap_offset],
            wrap_place=np.r_[lines.wrap_place, added.wrap_place],
        ),
        stiffness=np.r_[setting.stiffness, stiffness],
        reference_strain=np.r_[setting.reference_strain, reference_strain],
        owner=np.r_[setting.owner, none],
        share=np.r_[setting.share, np.zeros(len(none))],
    )
