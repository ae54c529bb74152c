"""Mechanics inputs at each load step, before and after effects."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from identknee.mechanics.contact_law import ContactLaw
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import ContactPoints, LineLigaments
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.mechanics.pose import place, start_pose
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry


@declared
class MeasuredFrames:
    """The frames between which poses are measured, loads act and flexion is prescribed.

    Of the femur and of the tibia, in this order. Poses of the model are those between these frames;
    insertions and surfaces are known in the frames of the geometry.
    """

    turns: Array = array("Their axes in those of the geometry, one a column", "bone", "3", "3")
    shifts: Array = array("Their origins there", "bone", "axis", unit="mm")

    def lines(self, lines: LineLigaments) -> LineLigaments:
        """Lines between insertions in the frames of the geometry, in these."""
        femoral, tibial = self.to_measured(lines.femoral, 0), self.to_measured(lines.tibial, 1)
        return replace(lines, femoral=femoral, tibial=tibial)

    def contact(self, contact: ContactPoints) -> ContactPoints:
        """The contact points, in the measured frame of the tibia."""
        return replace(contact, points=self.to_measured(contact.points, 1))

    def field(self, field: DistanceField) -> DistanceField:
        """The femur's distance, for poses of its measured frame."""
        return field.in_femoral_frame(self.turns[0], self.shifts[0])

    def pose(self, flexion: float, pose: Array) -> Array:
        """The pose (5,) between these frames where that between those of the geometry is given."""
        placed = place(flexion, pose)
        between = placed.to_femur(self.shifts[1]) - self.shifts[0]
        turn: Array = self.turns[0].T @ placed.rotation @ self.turns[1]
        _, between_frames = start_pose(turn, self.turns[0].T @ between)
        return between_frames

    def centres(self, centres: Array) -> Array:
        """Contact forces and their centres (n, k, 7), those in the frames of the geometry."""
        tibial, femoral = self.to_bone(centres[..., 1:4], 1), self.to_bone(centres[..., 4:], 0)
        return np.concatenate([centres[..., :1], tibial, femoral], axis=-1)

    def to_measured(self, points: Array, bone: int) -> Array:
        """Points (n, 3) in the frame of a bone's geometry, in its measured one [mm]."""
        return to_measured(points, self.turns[bone], self.shifts[bone])

    def to_bone(self, points: Array, bone: int) -> Array:
        """Points (n, 3) in a bone's measured frame, in that of its geometry [mm]."""
        return np.asarray(points @ self.turns[bone].T + self.shifts[bone])


def frames_at(values: Array) -> MeasuredFrames:
    """Frames turned about [deg] and shifted along [mm] the axes of the geometry.

    Parameters
    ----------
    values
        Rotation vector and shift of the femur's, then of the tibia's, shape ``(12,)``.
    """
    turns, shifts = placements(values[None])
    return MeasuredFrames(turns=turns[0], shifts=shifts[0])


def to_measured(points: Array, turns: Array, shifts: Array) -> Array:
    """Points (n, 3) in frames with the axes (..., 3, 3) and origins (..., 3), ``(..., n, 3)``."""
    return np.asarray((points - shifts[..., None, :]) @ turns)


def placements(values: Array) -> tuple[Array, Array]:
    """Axes, one a column, and origins of k pairs of frames, ``(k, 2, 3, 3)`` and ``(k, 2, 3)``.

    Parameters
    ----------
    values
        As in `frames_at`, shape ``(k, 12)``.
    """
    turns, shifts = np.moveaxis(values.reshape(-1, 2, 2, 3), 2, 0)
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial.transform import Rotation

    made = Rotation.from_rotvec(np.radians(turns.reshape(-1, 3))).as_matrix()
    return made.reshape(-1, 2, 3, 3), shifts


def motions(turns: Array, shifts: Array) -> Array:
    """Motion of contact between nearly equal frames, shape ``(k, 12)``.

    Small rotation vectors and shifts [rad, mm] that move places of the femoral frame within the
    femur, then the tibia's within the tibial frame.

    Parameters
    ----------
    turns, shifts
        Of `placements`, the first frames of each of k pairs and the second ones in turn.
    """
    back = np.swapaxes(turns, 2, 3)
    into_first, into_second = back[::2, 0], back[1::2, 1]
    moved = shifts[1::2] - shifts[::2]
    turned = np.stack([into_first @ turns[1::2, 0], into_second @ turns[::2, 1]])
    # Turned so little, a rotation is its antisymmetric part.
    femur, tibia = 0.5 * np.stack(
        [
            turned[..., 2, 1] - turned[..., 1, 2],
            turned[..., 0, 2] - turned[..., 2, 0],
            turned[..., 1, 0] - turned[..., 0, 1],
        ],
        axis=-1,
    )
    femoral = (into_first @ moved[:, 0, :, None])[..., 0]
    tibial = -(into_second @ moved[:, 1, :, None])[..., 0]
    return np.hstack([femur, femoral, tibia, tibial])


# Units of the mechanics per unit of a parameter: N per kN, strain per %.
PER_KN, PER_PCT = 1000.0, 0.01


@declared
class MechanicsInputs:
    """Loads, angles, lines and contact at the nodes of the load paths."""

    flexion: Array = entry("Flexion of each node [rad], shape ``(n,)``")
    loads: Array = entry(
        "Generalised loads of (varus, internal [N mm], x, y, z [N]), shape ``(n, 5)``: x anterior, "
        "y superior and z lateral, in the axes of the femur turned with flexion"
    )
    lines: LineLigaments = entry("All lines: the subject's ligaments first, in their order")
    stiffness: Array = entry("Stiffness of each line [N per unit strain], shape ``(m,)``")
    reference_strain: Array = entry("Reference strain of each line [-], shape ``(m,)``")
    owner: IntArray = entry(
        "Which ligament's calibrated stiffness and reference strain a line takes part in, -1 for "
        "none, shape ``(m,)``"
    )
    share: Array = entry("Share of its owner's stiffness, shape ``(m,)``")
    copy: IntArray = entry(
        "Which of several settings in one, with the same ligaments, a line belongs to, shape "
        "``(m,)``; -1 for lines added to that as a whole"
    )
    law: ContactLaw = entry("The contact law")
    start_flexion: float = entry("Flexion of the scanned pose [rad]")
    start: Array = entry("The scanned pose: varus, internal [rad], x, y, z [mm], shape ``(5,)``")
    measured: Array | None = entry(
        "The measured pose at each node, in the same form, ``(n, 5)``; None where none is known",
        default=None,
    )
    frames: MeasuredFrames | None = entry(
        "The frames between which poses are measured; None where they are those of the geometry, "
        "in which the lines and the scanned pose stand",
        default=None,
    )

    @property
    def measured_lines(self) -> LineLigaments:
        """The lines in the frames between which poses are measured."""
        return self.as_measured(self.lines)

    def as_measured(self, lines: LineLigaments) -> LineLigaments:
        """Any lines in the frames of the geometry, in those between which poses are measured."""
        return lines if self.frames is None else self.frames.lines(lines)

    def as_measured_points(self, points: Array, bone: int) -> Array:
        """Points (n, 3) of a bone, femur 0 and tibia 1, in the frame its poses are measured in."""
        return points if self.frames is None else self.frames.to_measured(points, bone)

    @property
    def start_pose_of_search(self) -> Array:
        """Start pose of each node: the measured pose, ``(n, 5)``, or the scanned one."""
        if self.measured is not None or self.frames is None:
            return self.start if self.measured is None else self.measured
        return self.frames.pose(self.start_flexion, self.start)

    def owned(self, n_ligaments: int) -> Array:
        """Which line belongs to which ligament, 1 or 0, shape ``(m, n_ligaments)``."""
        return np.asarray((self.owner[:, None] == np.arange(n_ligaments)).astype(float))

    def as_replica(self, number: int) -> "MechanicsInputs":
        """The same inputs as one replica of a batch."""
        return replace(self, copy=np.full(self.stiffness.size, number))

    def lengths_at_start(self, lines: LineLigaments) -> Array:
        """Lengths of lines in the scanned pose [mm], shape ``(m,)``."""
        return line_lengths(lines, self.start_flexion, self.start)


def with_lines(
    setting: MechanicsInputs, added: LineLigaments, stiffness: Array, reference_strain: Array
) -> MechanicsInputs:
    """The inputs with added lines that belong to none of the subject's ligaments."""
    none = np.full(len(added.femoral), -1)
    others = replace(
        setting,
        lines=added,
        stiffness=stiffness,
        reference_strain=reference_strain,
        owner=none,
        share=np.zeros(len(none)),
        copy=none,
    )
    return with_replicas(setting, [others], lines=True, nodes=False)


def with_replicas(
    setting: MechanicsInputs, others: Sequence[MechanicsInputs], *, lines: bool, nodes: bool
) -> MechanicsInputs:
    """The inputs with the lines, nodes or both of others appended."""
    parts = [setting, *others]
    changes: dict[str, Any] = {}
    if nodes:
        changes["flexion"] = np.concatenate([x.flexion for x in parts])
        changes["loads"] = np.concatenate([x.loads for x in parts])
        if setting.measured is not None:
            changes["measured"] = np.concatenate([x.measured for x in parts])
    if lines:
        changes["lines"] = LineLigaments(
            **{
                field.name: np.concatenate([getattr(x.lines, field.name) for x in parts])
                for field in fields(LineLigaments)
            }
        )
        for name in ("stiffness", "reference_strain", "owner", "share", "copy"):
            changes[name] = np.concatenate([getattr(x, name) for x in parts])
    return replace(setting, **changes)


def repeated(setting: MechanicsInputs, n: int) -> MechanicsInputs:
    """A batch of `n` replicas of the inputs."""

    def again(values: Array | IntArray) -> Any:
        return np.concatenate(n * [values])

    lines = {
        field.name: again(getattr(setting.lines, field.name)) for field in fields(LineLigaments)
    }
    return replace(
        setting,
        flexion=again(setting.flexion),
        loads=again(setting.loads),
        measured=None if setting.measured is None else again(setting.measured),
        lines=LineLigaments(**lines),
        stiffness=again(setting.stiffness),
        reference_strain=again(setting.reference_strain),
        owner=again(setting.owner),
        share=again(setting.share),
        copy=np.repeat(np.arange(n), setting.stiffness.size),
    )
