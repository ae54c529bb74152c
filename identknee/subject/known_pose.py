"""A pose that the subject's knee is known to take, where searches for equilibria can begin."""

from collections.abc import Sequence

import numpy as np

from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import declared, entry

# Coordinates of a laxity table: lateral shift, anterior drawer, distraction, varus, internal.
N_COORDINATES = 5


@declared
class KnownPose:
    """Coordinates of the tibia at a flexion angle, between the frames in which tests are read.

    Raises
    ------
    ValueError
        If a number is not finite or there are not five coordinates.
    """

    flexion_deg: float = entry("Flexion")
    coordinates: Array = entry(
        "Lateral shift, anterior drawer, distraction [mm], varus, internal rotation [deg], shape "
        "``(5,)``"
    )

    def __post_init__(self) -> None:
        place = frozen(self.coordinates, N_COORDINATES, name="the coordinates of a pose")
        if not np.isfinite([self.flexion_deg, *place]).all():
            raise ValueError(
                f"a pose must be finite numbers, got {place.tolist()} at {self.flexion_deg:g} deg"
            )
        object.__setattr__(self, "coordinates", place)


def pose_at(poses: Sequence[KnownPose], flexion_deg: Array) -> Array:
    """Coordinates between the known poses at flexion angles (n,), shape ``(n, 5)``.

    On straight lines from one to the next, and as in the last one beyond it.

    Examples
    --------
    >>> pose = [KnownPose(flexion_deg=x, coordinates=np.full(5, x)) for x in (0.0, 30.0)]
    >>> pose_at(pose, np.array([15.0, 90.0]))[:, 0].tolist()
    [15.0, 30.0]
    """
    ordered = sorted(poses, key=lambda x: x.flexion_deg)
    angles = [x.flexion_deg for x in ordered]
    known = np.array([x.coordinates for x in ordered])
    return np.column_stack([np.interp(flexion_deg, angles, column) for column in known.T])
