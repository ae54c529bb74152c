"""The anatomical frames of femur and tibia, given or made from landmarks."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import CHECK_UNITS, Array, frozen, implausible_coordinates
from identknee.runs.errors import ValueRefused

# Axes written with three decimals are off by less; a sheared or scaled frame by more.
ROUNDING = 2e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A right-handed frame of a bone in the common frame of the scanned pose.

    Attributes
    ----------
    origin
        Position [mm], shape ``(3,)``.
    axes
        Unit vectors as rows: anterior, superior, lateral; shape ``(3, 3)``. Rows rounded in a file
        are squared up to the nearest rotation.

    Raises
    ------
    ValueError
        If a value is not finite, or the axes are not orthonormal or not right-handed.
    """

    origin: Array
    axes: Array

    def __post_init__(self) -> None:
        origin = frozen(self.origin, 3, name="the origin of a frame")
        axes = frozen(self.axes, 3, 3, name="the axes of a frame")
        if not (np.isfinite(origin).all() and np.isfinite(axes).all()):
            raise ValueError("the origin and axes of a frame must be finite numbers")
        if far := implausible_coordinates(origin):
            raise ValueRefused(f"the origin of a frame lies {far}", CHECK_UNITS)
        # Products of larger numbers may overflow.
        error = (
            np.inf if np.abs(axes).max() > 2.0 else float(np.abs(axes @ axes.T - np.eye(3)).max())
        )
        if error > ROUNDING:
            raise ValueRefused(
                "the axes of a frame must be unit vectors at right angles, one a row, but their "
                f"products are off by {error:.2g}",
                "normalise them",
            )
        if np.linalg.det(axes) < 0.0:
            why = "the axes of a frame must be right-handed: x anterior, y superior, z to the right"
            raise ValueRefused(why, "turn one of them round")
        if error > 1e-12:
            left, _, right = np.linalg.svd(axes)
            axes = frozen(left @ right, 3, 3, name="the axes of a frame")
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "axes", axes)

    def to_local(self, points: ArrayLike) -> Array:
        """Points ``(..., 3)`` of the common frame in this frame [mm]."""
        return np.asarray((np.asarray(points, float) - self.origin) @ self.axes.T)

    def to_common(self, points: ArrayLike) -> Array:
        """Points ``(..., 3)`` of this frame in the common frame [mm]."""
        return np.asarray(np.asarray(points, float) @ self.axes + self.origin)

    def mirrored(self) -> "Frame":
        """The frame seen in the mirror z = 0, its third axis turned round to be lateral again."""
        mirror = np.array([1.0, 1.0, -1.0])
        return Frame(origin=self.origin * mirror, axes=mirror[:, None] * self.axes * mirror)


def joint_centre(landmarks: Mapping[str, Array]) -> Array | None:
    """Midpoint of the epicondyles [mm], shape ``(3,)``; None where they are not given."""
    return _midpoint(landmarks, "medial_epicondyle", "lateral_epicondyle")


def ankle_centre(landmarks: Mapping[str, Array]) -> Array | None:
    """The ankle centre, or the midpoint of the malleoli [mm], ``(3,)``; None without either."""
    if "ankle_centre" in landmarks:
        return landmarks["ankle_centre"]
    return _midpoint(landmarks, "medial_malleolus", "lateral_malleolus")


def frames_from_landmarks(
    landmarks: Mapping[str, Array], *, is_left: bool = False
) -> tuple[Frame, Frame]:
    """The frames of femur and tibia that landmarks define.

    Both origins are the midpoint of the epicondyles. The femur's y axis points from there to the
    hip centre, the tibia's from the ankle centre to there; both z axes lie in the plane that y
    spans with the line through the epicondyles and point to the subject's right.

    Parameters
    ----------
    landmarks
        Positions in the common frame [mm], shape ``(3,)``, by their names in a subject's file; the
        ankle is given by its centre or by both malleoli.
    is_left
        Whether this is a left knee, whose lateral side is on the left.

    Raises
    ------
    ValueError
        If a landmark is missing or two of them nearly coincide.
    """
    centre, ankle = joint_centre(landmarks), ankle_centre(landmarks)
    hip = landmarks.get("hip_centre")
    if centre is None or ankle is None or hip is None:
        raise ValueRefused(
            f"the landmarks given ({', '.join(landmarks) or 'none'}) define no frames",
            "give hip_centre, medial_epicondyle, lateral_epicondyle and either ankle_centre or "
            "both malleoli, or the frames themselves",
        )
    across = landmarks["lateral_epicondyle"] - landmarks["medial_epicondyle"]
    right = -across if is_left else across
    return _frame(centre, hip - centre, right), _frame(centre, centre - ankle, right)


def angle_between(one: Array, other: Array) -> float:
    """Angle between two vectors [deg].

    Examples
    --------
    >>> round(angle_between(np.array([1.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])), 6)
    90.0
    """
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _midpoint(landmarks: Mapping[str, Array], one: str, other: str) -> Array | None:
    if one in landmarks and other in landmarks:
        return np.asarray((landmarks[one] + landmarks[other]) / 2.0)
    return None


def _frame(origin: Array, up: Array, right: Array) -> Frame:
    length = np.linalg.norm(up)
    if length == 0.0 or np.linalg.norm(np.cross(up, right)) <= 0.1 * length * np.linalg.norm(right):
        raise ValueRefused(
            "the landmarks define no frame: the epicondyles coincide or lie on the long axis of "
            "the bone",
            "check their coordinates",
        )
    superior = up / length
    lateral = right - (right @ superior) * superior
    lateral = lateral / np.linalg.norm(lateral)
    return Frame(origin=origin, axes=np.array([np.cross(superior, lateral), superior, lateral]))
