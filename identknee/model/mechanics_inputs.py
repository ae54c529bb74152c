"""Mechanics inputs at each load step, with and without effects, and the poses to start from."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from identknee.laxity.protocol import ABSOLUTE, Protocol
from identknee.laxity.table import Laxity
from identknee.mechanics.distance_field import ContactLaw, DistanceField
from identknee.mechanics.equilibria import ContactPoints, LineLigaments
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.mechanics.pose import coordinates_from_pose, place, pose_from_coordinates, start_pose
from identknee.runs.declare import Array, IntArray, array, declared, entry
from identknee.subject.knee import Knee, KnownPose, pose_at


@declared
class MeasuredFrames:
    """The frames of the femur and of the tibia as measured.

    Poses are measured, loads act and flexion is prescribed between these frames. Insertions and
    surfaces are known in the frames of the geometry, which may differ.
    """

    turns: Array = array(
        "Axes of the measured frames in the frames of the geometry, as columns", "bone", "3", "3"
    )
    shifts: Array = array(
        "Origins of the measured frames in the frames of the geometry", "bone", "axis", unit="mm"
    )

    def lines(self, lines: LineLigaments) -> LineLigaments:
        """Lines, given in the frames of the geometry, in the measured frames."""
        femoral, tibial = self.to_measured(lines.femoral, 0), self.to_measured(lines.tibial, 1)
        centre, axis = np.array(lines.obstacle_centre), np.array(lines.obstacle_axis)
        for bone in range(2):
            own = lines.with_obstacles_of(bone)
            centre[own] = self.to_measured(centre[own], bone)
            axis[own] = axis[own] @ self.turns[bone]
        return replace(
            lines, femoral=femoral, tibial=tibial, obstacle_centre=centre, obstacle_axis=axis
        )

    def contact(self, contact: ContactPoints) -> ContactPoints:
        """The contact points and the menisci, in the measured frame of the tibia."""
        menisci = contact.menisci
        if menisci is not None:
            menisci = replace(menisci, points=self.to_measured(menisci.points, 1))
        return replace(contact, points=self.to_measured(contact.points, 1), menisci=menisci)

    def field(self, field: DistanceField) -> DistanceField:
        """The distance field of the femur, for poses of its measured frame."""
        return replace(field, turn=self.turns[0], shift=self.shifts[0])

    def pose(self, flexion: float, pose: Array) -> Array:
        """The pose (5,) between the measured frames, from that between those of the geometry."""
        placed = place(flexion, pose)
        between = placed.to_femur(self.shifts[1][None])[0] - self.shifts[0]
        turn: Array = self.turns[0].T @ placed.rotation @ self.turns[1]
        _, between_frames = start_pose(turn, self.turns[0].T @ between)
        return between_frames

    def centres(self, centres: Array) -> Array:
        """Contact forces and their centres (n, k, 7), with centres in the geometry's frames."""
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
    # Imported here, because the import takes longer than a simulation.
    from scipy.spatial.transform import Rotation

    made = Rotation.from_rotvec(np.radians(turns.reshape(-1, 3))).as_matrix()
    return made.reshape(-1, 2, 3, 3), shifts


def motions(turns: Array, shifts: Array) -> Array:
    """Motion of contact between nearly equal frames, shape ``(k, 12)``.

    Each row has the small rotation vector and shift [rad, mm] by which points of the femoral frame
    move in the femur, then those by which points of the tibia move in the tibial frame.

    Parameters
    ----------
    turns, shifts
        From `placements`, first and second frames of each of k pairs in turn.
    """
    back = np.swapaxes(turns, 2, 3)
    into_first, into_second = back[::2, 0], back[1::2, 1]
    moved = shifts[1::2] - shifts[::2]
    turned = np.stack([into_first @ turns[1::2, 0], into_second @ turns[::2, 1]])
    # The rotation vector of a small rotation is its antisymmetric part.
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
    menisci: Array | None = entry(
        "Stiffness of the medial and of the lateral meniscus [N/mm3], and how much higher they are "
        "than the gaps in the scanned pose [mm], shape ``(3,)``; None without menisci",
        default=None,
    )
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

    def tiled(values: Any) -> Any:
        return np.tile(values, (n, *(1 for _ in values.shape[1:])))

    lines = setting.lines
    return replace(
        setting,
        flexion=tiled(setting.flexion),
        loads=tiled(setting.loads),
        measured=None if setting.measured is None else tiled(setting.measured),
        lines=LineLigaments(**{x.name: tiled(getattr(lines, x.name)) for x in fields(lines)}),
        stiffness=tiled(setting.stiffness),
        reference_strain=tiled(setting.reference_strain),
        owner=tiled(setting.owner),
        share=tiled(setting.share),
        copy=np.repeat(np.arange(n), setting.stiffness.size),
    )


# Interval of flexion [deg] over which the poses of trials are averaged.
POSE_EVERY_DEG = 15.0
# Share by which the longest length of a ligament exceeds the next one if its pose is a blunder.
BLUNDER = 0.2


def measured_poses(laxity: Laxity) -> Array | None:
    """The measured pose of each trial, from which its equilibrium is sought, ``(n, 5)``.

    None if the trials have nominal angles (most share one, or all are whole degrees), if the
    coordinates are not absolute, or if one was never measured. A blank cell is filled with the
    value of the trial nearest in flexion.
    """
    angles, measured = laxity.protocol.flexion_deg, laxity.is_measured
    is_nominal = 2 * len(np.unique(angles)) <= laxity.n or not np.any(angles % 1.0)
    if is_nominal or laxity.zero != ABSOLUTE or not measured.any(axis=0).all():
        return None
    # A measured cell keeps its own value, even if another trial has the same angle.
    nearest = np.repeat(np.arange(laxity.n)[:, None], measured.shape[1], axis=1)
    for column, known in zip(nearest.T, measured.T, strict=True):
        others = np.flatnonzero(known)
        apart = np.abs(angles[~known, None] - angles[others])
        column[~known] = others[np.argmin(apart, axis=1)]
    return pose_from_coordinates(np.take_along_axis(laxity.coordinates, nearest, axis=0))


def fallback_poses(knee: Knee, laxity: Laxity) -> Array | None:
    """The measured pose of each trial if the knee states errors, ``(n, 5)``; NaN where unknown.

    None if the knee is taken as exact, so that the load path belongs to the model, or if the
    coordinates are not absolute.
    """
    if knee.uncertainty.is_exact or laxity.zero != ABSOLUTE:
        return None
    return pose_from_coordinates(laxity.coordinates)


def holding_poses(scanned: Array, laxity: Laxity) -> Array:
    """A complete pose of each trial, near the measured one, shape ``(n, 5)``.

    A coordinate that was not measured is taken from the trial nearest in flexion, or from the
    scanned pose if no trial has it. All are those of the scanned pose if coordinates are not
    absolute.
    """
    coordinates = np.tile(coordinates_from_pose(scanned), (laxity.n, 1))
    if laxity.zero == ABSOLUTE:
        angles, measured = laxity.protocol.flexion_deg, laxity.is_measured
        apart = np.abs(angles[:, None] - angles) - np.eye(laxity.n)
        for j in np.flatnonzero(measured.any(axis=0)).tolist():
            nearest = np.argmin(np.where(measured[:, j], apart, np.inf), axis=1)
            coordinates[:, j] = laxity.coordinates[nearest, j]
    return pose_from_coordinates(coordinates)


def known_poses(knee: Knee, protocol: Protocol) -> Array | None:
    """Stated pose of each trial, shape ``(n, 5)``; None if the knee states none.

    It does not depend on the load: stated poses are means over the loads at a flexion angle.
    """
    if not knee.poses:
        return None
    return pose_from_coordinates(pose_at(knee.poses, protocol.flexion_deg))


def poses_of(protocol: Protocol, coordinates: Array) -> tuple[KnownPose, ...]:
    """The mean pose of the trials near each flexion angle, from coordinates ``(n, 5)``.

    Trials without coordinates are left out.
    """
    has_pose = np.isfinite(coordinates).all(axis=1)
    angles = protocol.flexion_deg
    group = np.round(angles / POSE_EVERY_DEG)
    made = []
    for one in np.unique(group[has_pose]).tolist():
        own = has_pose & (group == one)
        made.append(
            KnownPose(
                flexion_deg=float(angles[own].mean()), coordinates=coordinates[own].mean(axis=0)
            )
        )
    return tuple(made)


def poses_between(made: Protocol, poses: Array | None, asked: Protocol) -> Array | None:
    """Start poses of trials interpolated from measured poses ``(n, 5)``, ``(k, 5)``.

    None if there are no measured poses. A trial that was made keeps its pose. Another one begins at
    the mean pose over all loads, interpolated linearly over flexion.
    """
    if poses is None:
        return None
    known = dict(zip(_keys(made), poses, strict=True))
    middle = poses_of(made, coordinates_from_pose(poses))
    between = pose_from_coordinates(pose_at(middle, asked.flexion_deg))
    return np.array([known.get(x, y) for x, y in zip(_keys(asked), between, strict=True)])


def poses_of_measured_trials(made: Protocol, poses: Array | None, asked: Protocol) -> Array | None:
    """Measured poses of the trials that were made, NaN for others, ``(k, 5)``."""
    if poses is None:
        return None
    known = dict(zip(_keys(made), poses, strict=True))
    return np.array([known.get(x, np.full(5, np.nan)) for x in _keys(asked)])


def _keys(protocol: Protocol) -> list[tuple[str, float, bytes]]:
    """Keys that are equal for the same trial in two protocols: name, flexion and loads."""
    rows = zip(protocol.trials, protocol.flexion_deg.tolist(), protocol.loads, strict=True)
    return [(name, angle, loads.tobytes()) for name, angle, loads in rows]


def strains_as_measured(setting: MechanicsInputs, stretch: float) -> Array:
    """Reference strain [%] of each line that the measured poses stretch by `stretch` at most.

    Parameters
    ----------
    setting
        Inputs with measured poses.
    stretch
        Strain of each line at the longest of its measured lengths; at the longest but one where
        a single pose would stretch it by a fifth more than all others, as a blunder does.

    Returns
    -------
    strains
        Shape ``(m,)``.

    Raises
    ------
    ValueError
        If the setting has no measured poses.
    """
    if setting.measured is None:
        raise ValueError("strains from measured poses need a model that begins there")
    places = zip(setting.flexion.tolist(), setting.measured, strict=True)
    lines = setting.measured_lines
    lengths = np.sort([line_lengths(lines, angle, pose) for angle, pose in places], axis=0)
    longest, others = lengths[-1], lengths[max(len(lengths) - 2, 0)]
    longest = np.where(longest > (1.0 + BLUNDER) * others, others, longest)
    reference = np.asarray(setting.lines.reference_length)
    return np.asarray(((1.0 + stretch) * reference / longest - 1.0) / PER_PCT)
