"""Frames of the bones in which poses were measured, apart from those of the bones' geometry."""

from dataclasses import replace

import numpy as np

from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import ContactPoints, Lines
from identknee.mechanics.placement import place
from identknee.mechanics.pose import start_pose
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared


@declared
class MeasuredFrames:
    """The frames between which poses are measured, loads act and flexion is prescribed.

    Of the femur and of the tibia, in this order. Poses of the model are those between these frames;
    insertions and surfaces are known in the frames of the geometry.
    """

    turns: Array = array("Their axes in those of the geometry, one a column", "bone", "3", "3")
    shifts: Array = array("Their origins there", "bone", "axis", unit="mm")

    def lines(self, lines: Lines) -> Lines:
        """Lines between insertions in the frames of the geometry, in these."""
        femoral, tibial = self.to_measured(lines.femoral, 0), self.to_measured(lines.tibial, 1)
        return replace(lines, femoral=femoral, tibial=tibial)

    def contact(self, contact: ContactPoints) -> ContactPoints:
        """The contact points, in the measured frame of the tibia."""
        return replace(contact, points=self.to_measured(contact.points, 1))

    def field(self, field: DistanceField) -> DistanceField:
        """The femur's distance, for poses of its measured frame."""
        return field.seen_from(self.turns[0], self.shifts[0])

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
    """How contact moves where frames give way to nearly equal ones, shape ``(k, 12)``.

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
