"""The menisci as wedges between the plateaus and the femur: points, heights and stiffness.

A point i of a plateau's periphery stores the energy ``1/2 k A_i max(0, h_i - phi)^2``, where phi is
its distance to the femur, A_i its area, k the stiffness of its meniscus and h_i the height of the
wedge: how far from the femur it begins to press. The touch is rounded by the parabola of contact.
"""

from dataclasses import replace

import numpy as np

from identknee.mechanics.distance_field import MOST_ROUNDING, ContactLaw, DistanceField
from identknee.mechanics.memory import GRID, MeniscusArrays, read_only, record
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry


@declared
class Menisci:
    """The medial and the lateral meniscus, in tibial axes."""

    points: Array = array("Places on the plateaus", "point", "axis", unit="mm")
    areas: Array = array("Tributary areas", "point", unit="mm2")
    heights: Array = array("Distance to the femur at which each begins to press", "point")
    side: IntArray = array("0 on the medial side, 1 on the lateral one", "point", dtype=int)
    stiffness: Array = array(
        "Pressure per compression of the medial and of the lateral meniscus", "2", unit="N/mm3"
    )
    field: DistanceField | None = entry(
        "Distance to the femur in the frame of the contact's field, up to larger distances; None "
        "where there are no points"
    )

    def at(self, values: Array) -> "Menisci":
        """The menisci at `values`: stiffness of each side [N/mm3], and added height [mm]."""
        return replace(self, stiffness=values[:2], heights=self.heights + values[2])

    def arrays(self) -> MeniscusArrays:
        """The points as the kernel takes them."""
        grid = record(GRID)
        coefficients = np.zeros(0)
        if self.field is not None:
            coefficients = self.field.coefficients.reshape(-1)
            grid.origin, grid.spacing = self.field.origin, self.field.spacing
            grid.shape = self.field.coefficients.shape
        arrays = MeniscusArrays(
            points=np.ascontiguousarray(self.points.T),
            areas=self.areas,
            heights=self.heights,
            side=self.side,
            stiffness=self.stiffness,
            coefficients=coefficients,
            grid=grid,
        )
        return read_only(arrays)


# The law of a meniscus of one N/mm3.
UNIT_LAW = ContactLaw(modulus=1.0, rounding=MOST_ROUNDING)
NO_MENISCI = Menisci(
    points=np.zeros((0, 3)),
    areas=np.zeros(0),
    heights=np.zeros(0),
    side=np.zeros(0, np.int64),
    stiffness=np.zeros(2),
    field=None,
)
