"""A signed distance to the femur as a cubic spline on a grid, with what its cells can hold."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from identknee.mechanics.contact_law import MOST_ROUNDING
from identknee.mechanics.memory import (
    FIRST_ROUNDED,
    GRID,
    NEAR_CELLS,
    FieldArrays,
    read_only,
    record,
)
from identknee.runs.arrays import Array, BitArray, ReachArray
from identknee.runs.declare import declared, entry

SPACING = 0.75  # mm
PADDING = 5  # cells around the surface: room for the candidate list and the spline's support
STRAIGHT = 8  # nodes; what the filter does at an end decays by 0.27 a node


@declared
class DistanceField:
    """Signed distance to a surface, negative inside, as a uniform cubic B-spline (C2)."""

    coefficients: Array = entry("Spline coefficients [mm], shape ``(nx, ny, nz)``")
    reach: ReachArray = entry(
        "What each cell can hold, shape ``(nx, ny, nz)``: bits 0-7, contact without rounding may "
        "lie in that eighth (the least of its Bezier coefficients is below 0); bits 8-15, contact "
        "with the most rounding may"
    )
    near: BitArray = entry(
        "One bit a cell, whether one close by has any of those bits: shape ``(nx, ny, nz / 8)``, "
        "the lowest bit first"
    )
    origin: Array = entry("Position of the first node [mm], shape ``(3,)``")
    spacing: float = entry("Distance between nodes [mm]")
    turn: Array | None = entry(
        "Axes of the femoral frame of poses in those of the field, one a column, shape ``(3, 3)``; "
        "None where both are the same",
        default=None,
    )
    shift: Array | None = entry("Origin of that frame [mm], shape ``(3,)``", default=None)

    def __post_init__(self) -> None:
        for name in ("coefficients", "reach", "near", "origin"):
            array = np.ascontiguousarray(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def arrays(self) -> FieldArrays:
        """The field as the kernel takes it."""
        grid = record(GRID)
        grid.origin, grid.spacing = self.origin, self.spacing
        grid.shape, grid.is_apart = self.coefficients.shape, self.turn is not None
        grid.turn = np.ravel(np.eye(3) if self.turn is None else self.turn)
        grid.shift = 0.0 if self.shift is None else self.shift
        arrays = FieldArrays(
            coefficients=self.coefficients.reshape(-1),
            reach=self.reach.reshape(-1),
            near=self.near.reshape(-1),
            grid=grid,
        )
        return read_only(arrays)

    def in_femoral_frame(self, turn: Array, shift: Array) -> "DistanceField":
        """The same field under poses of another femoral frame, given by its axes and origin."""
        return replace(self, turn=turn, shift=shift)

    def to_field(self, places: Array) -> Array:
        """Places (n, 3) of the femoral frame of poses in the field's [mm]."""
        if self.turn is None or self.shift is None:
            return places
        return np.asarray(places @ self.turn.T + self.shift)


def build_field(
    distance: Callable[[Array], Array], lower: Array, upper: Array, *, spacing: float = SPACING
) -> DistanceField:
    """The distance field of a surface that lies between `lower` and `upper` [mm].

    Parameters
    ----------
    distance
        Gives the signed distance [mm] of points, shape ``(n, 3)``, negative inside.
    """
    # Loaded late: most fields are read from the cache.
    from scipy.ndimage import spline_filter

    origin = np.asarray(lower, float) - PADDING * spacing
    shape = np.ceil((np.asarray(upper) - origin) / spacing).astype(int) + PADDING + 1
    axes = [origin[i] + spacing * np.arange(shape[i]) for i in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = distance(nodes).reshape(shape)
    # The filter mirrors what it is given, which bends a distance at the grid's faces; continued
    # straight for a few nodes, the spline is right to fourth order up to there.
    wide = np.pad(values, STRAIGHT, mode="reflect", reflect_type="odd")
    inner = (slice(STRAIGHT, -STRAIGHT),) * 3
    coefficients = spline_filter(wide, order=3, mode="mirror")[inner]
    reach = _reach(coefficients)
    return DistanceField(
        coefficients=coefficients,
        reach=reach,
        near=_near(reach),
        origin=origin,
        spacing=spacing,
    )


def _reach(coefficients: Array) -> ReachArray:
    """What each cell can hold; the outermost cells, which lack support, hold nothing."""
    from scipy.ndimage import maximum_filter, minimum_filter

    support = np.lib.stride_tricks.sliding_window_view(coefficients, (4, 4, 4))
    inner = (slice(1, -2),) * 3
    # A spline lies within the hull of its coefficients; only where the gap is among them is it
    # worth finding the tighter hull of the Bezier coefficients of each eighth of the cell.
    lowest = minimum_filter(coefficients, size=4, origin=-1)[inner]
    highest = maximum_filter(coefficients, size=4, origin=-1)[inner]
    reach = np.zeros(coefficients.shape, np.uint16)
    holds = reach[inner]
    for gap, first in ((0.0, 0), (MOST_ROUNDING, FIRST_ROUNDED)):
        holds[highest < gap] |= np.uint16(255 << first)
        undecided = np.nonzero((lowest < gap) & (highest >= gap))
        corners = support[undecided].reshape(-1, 64)
        for eighth in range(8):
            x, y, z = (_HALVES[eighth >> axis & 1] for axis in (2, 1, 0))
            bezier = corners @ np.kron(x, np.kron(y, z)).T
            may = (bezier.min(axis=1) < gap).astype(np.uint16)
            holds[undecided] |= may << np.uint16(first + eighth)
    return reach


def _near(reach: ReachArray) -> BitArray:
    """Which cells are near one that may hold contact; the outermost are not."""
    from scipy.ndimage import maximum_filter

    near = np.zeros(reach.shape, bool)
    inner = (slice(1, -2),) * 3
    near[inner] = maximum_filter(reach > 0, size=2 * NEAR_CELLS + 1)[inner]
    return np.packbits(near, axis=2, bitorder="little")


# Bezier coefficients of the lower and the upper half of a cell from the four spline coefficients.
_BEZIER = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0
_LOWER = np.array([[8, 0, 0, 0], [4, 4, 0, 0], [2, 4, 2, 0], [1, 3, 3, 1]]) / 8.0
_HALVES = (_LOWER @ _BEZIER, _LOWER[::-1, ::-1] @ _BEZIER)
