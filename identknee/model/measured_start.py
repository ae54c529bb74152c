"""Start poses and strains of a model of a measured table."""

from collections.abc import Sequence

import numpy as np

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.mechanics.grood_suntay import coordinates_from_pose, pose_from_coordinates
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.mechanics_inputs import PER_PCT, MechanicsInputs
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee, KnownPose, pose_at

# Trials within so many degrees of flexion of each other have one pose between them.
POSE_EVERY_DEG = 15.0
# Above the next longest length of a ligament no single trial stretches it so far.
BLUNDER = 0.2


def measured_poses(laxity: Laxity) -> Array | None:
    """The measured pose of each trial, from which its equilibrium is sought, ``(n, 5)``.

    None where the trials have nominal angles (most share one, or all are whole degrees), where the
    coordinates count from an unloaded pose, or where one was never measured. A cell not measured
    has the value of the trial nearest in flexion.
    """
    angles, measured = laxity.protocol.flexion_deg, laxity.is_measured
    is_nominal = 2 * len(np.unique(angles)) <= laxity.n or not np.any(angles % 1.0)
    if is_nominal or laxity.zero != "absolute" or not measured.any(axis=0).all():
        return None
    # Its own cell comes first, also before that of another reading at the same angle.
    apart = np.abs(angles[:, None] - angles) - np.eye(laxity.n)
    nearest = np.argmin(np.where(measured.T[:, None], apart, np.inf), axis=2).T
    return pose_from_coordinates(np.take_along_axis(laxity.coordinates, nearest, axis=0))


def fallback_poses(knee: Knee, laxity: Laxity) -> Array | None:
    """The measured pose of each trial where the knee states errors, shape ``(n, 5)``; NaN unknown.

    None where the knee is taken as exact, so that the path of a load is part of the model, or where
    the coordinates count from an unloaded pose.
    """
    if knee.uncertainty.is_exact or laxity.zero != "absolute":
        return None
    return pose_from_coordinates(laxity.coordinates)


def known_poses(knee: Knee, protocol: Protocol) -> Array | None:
    """Stated pose of each trial, shape ``(n, 5)``; None if the knee states none.

    No load is looked at: it is the pose in the middle of what the loads do at that flexion angle.
    """
    if not knee.poses:
        return None
    return pose_from_coordinates(pose_at(knee.poses, protocol.flexion_deg))


def poses_of_tests(knee: Knee, laxity: Laxity) -> tuple[Array | None, Array | None]:
    """Start poses of measured trials, and fallback poses for paths without an equilibrium.

    First the measured poses, or those that the knee is known to take; None without both. Then
    `fallback_poses`, where that is so.
    """
    poses = measured_poses(laxity)
    poses = known_poses(knee, laxity.protocol) if poses is None else poses
    return poses, fallback_poses(knee, laxity) if poses is None else None


def same_poses(some: Sequence[Array | None], others: Sequence[Array | None]) -> bool:
    """Whether poses are equal one by one; NaN equals NaN."""
    return all(
        x is y if x is None or y is None else np.array_equal(x, y, equal_nan=True)
        for x, y in zip(some, others, strict=True)
    )


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

    None where those begin at none. A trial that was made begins where it did, another in the
    middle of what the loads do at its flexion angle, on straight lines between the angles of those
    made.
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
    """What makes each trial the same as another one: name, flexion and loads."""
    rows = zip(protocol.trials, protocol.flexion_deg.tolist(), protocol.loads, strict=True)
    return [(name, angle, loads.tobytes()) for name, angle, loads in rows]


def strains_as_measured(setting: MechanicsInputs, stretch: float) -> Array:
    """Reference strain [%] of each line that the measured poses stretch by `stretch` at most.

    Parameters
    ----------
    setting
        With measured poses.
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
