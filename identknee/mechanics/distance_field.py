"""A signed distance to the femur as a cubic spline on a grid, with what its cells can hold."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, spline_filter

from identknee.mechanics.kernel import HOLDS_CONTACT, IS_NEAR, NEAR_CELLS
from identknee.runs.arrays import Array, IntArray, frozen

ByteArray = NDArray[np.uint8]

SPACING = 0.75  # mm
PADDING = 5  # cells around the surface: room for the candidate list and the spline's support


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DistanceField:
    """Signed distance to a surface, negative inside, as a uniform cubic B-spline (C2).

    Attributes
    ----------
    coefficients
        Spline coefficients [mm], shape ``(nx, ny, nz)``.
    reach
        What each cell can hold, shape ``(nx, ny, nz)``: bit 1, the distance may be negative in it
        (the least of its Bezier coefficients is); bit 2, a cell close by has bit 1.
    origin
        Position of the first node [mm], shape ``(3,)``.
    spacing
        Distance between nodes [mm].
    """

    coefficients: Array
    reach: ByteArray
    origin: Array
    spacing: float

    def arrays(self) -> tuple[Array, ByteArray, Array, Array, IntArray]:
        """The field as the kernel takes it."""
        return (
            self.coefficients.reshape(-1),
            self.reach.reshape(-1),
            self.origin,
            np.array([self.spacing]),
            np.array(self.coefficients.shape, np.int64),
        )


def build_field(
    distance: Callable[[Array], Array], lower: Array, upper: Array, *, spacing: float = SPACING
) -> DistanceField:
    """The distance field of a surface that lies between `lower` and `upper` [mm].

    Parameters
    ----------
    distance
        Gives the signed distance [mm] of points, shape ``(n, 3)``, negative inside.
    """
    origin = np.asarray(lower, float) - PADDING * spacing
    shape = np.ceil((np.asarray(upper) - origin) / spacing).astype(int) + PADDING + 1
    axes = [origin[i] + spacing * np.arange(shape[i]) for i in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = distance(nodes).reshape(shape)
    coefficients = spline_filter(values, order=3, mode="mirror")
    return DistanceField(
        coefficients=frozen(coefficients, None, None, None, name="coefficients"),
        reach=_reach(coefficients),
        origin=frozen(origin, 3, name="origin"),
        spacing=spacing,
    )


def _reach(coefficients: Array) -> ByteArray:
    """What each cell can hold; the outermost cells, which lack support, hold nothing."""
    support = np.lib.stride_tricks.sliding_window_view(coefficients, (4, 4, 4))
    inner = (slice(1, -2),) * 3
    # A spline lies within the hull of its coefficients; only where they differ in sign is it worth
    # finding the tighter hull of the cell's Bezier coefficients.
    lowest = minimum_filter(coefficients, size=4, origin=-1)[inner]
    highest = maximum_filter(coefficients, size=4, origin=-1)[inner]
    holds_inside = highest < 0.0
    undecided = np.nonzero((lowest < 0.0) & ~holds_inside)
    corners = support[undecided]
    bezier = np.einsum("ai,bj,ck,nijk->nabc", *(_BEZIER_FROM_SPLINE,) * 3, corners, optimize=True)
    holds_inside[undecided] = bezier.min(axis=(1, 2, 3)) < 0.0
    holds = np.zeros(coefficients.shape, bool)
    holds[inner] = holds_inside
    near = maximum_filter(holds, size=2 * NEAR_CELLS + 1)
    has_support = np.zeros_like(holds)
    has_support[inner] = True
    reach = (HOLDS_CONTACT * holds + IS_NEAR * (near & has_support)).astype(np.uint8)
    reach.flags.writeable = False
    return reach


_BEZIER_FROM_SPLINE = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0
