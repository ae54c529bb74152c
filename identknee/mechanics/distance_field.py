"""A signed distance to the femur as a cubic spline on a grid, and the pressure at a depth."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from identknee.mechanics.memory import (
    FIRST_ROUNDED,
    GRID,
    NEAR_CELLS,
    FieldArrays,
    read_only,
    record,
)
from identknee.runs.declare import Array, BitArray, ReachArray, declared, entry
from identknee.runs.progress import progress

PRESSURE_MODULUS = 10.0  # N/mm3, the paper's 10 GN/m3
# mm; at this depth the pressure does not depend on the exponent of the law.
REFERENCE_DEPTH = 0.3
# mm; the distance field marks the cells of points that come this near.
MOST_ROUNDING = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactLaw:
    """Pressure of the contact, ``modulus depth (depth / REFERENCE_DEPTH)^(exponent - 1)``.

    Attributes
    ----------
    modulus
        [N/mm3], > 0.
    exponent
        Exponent of the depth, > 0; the paper's law has 1.
    rounding
        Gap at which the pressure begins [mm], 0 to 0.15, and depth from which it is the law's
        again; the paper's law has 0. Between them the depth counts as the parabola
        ``(depth + rounding)^2 / (4 rounding)``, which joins zero and the depth itself without a
        kink, so that a contact point which begins to touch does not change the stiffness of the
        joint at once.

    Raises
    ------
    ValueError
        If the rounding is negative or larger than the distance field allows for.
    """

    modulus: float = PRESSURE_MODULUS
    exponent: float = 1.0
    rounding: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.rounding <= MOST_ROUNDING:
            raise ValueError(
                f"the rounding of the contact law must be 0 to {MOST_ROUNDING:g} mm, got "
                f"{self.rounding:g}; leave it out for the law without rounding"
            )

    def pressure(self, depth: Array) -> tuple[Array, Array]:
        """Pressure [N/mm2] at depths [mm], negative for gaps, and its derivative [N/mm3]."""
        reach = np.maximum(depth + self.rounding, 0.0)
        is_rounded = depth < self.rounding
        steepness = reach / (2.0 * self.rounding) if self.rounding else np.zeros_like(reach)
        felt = np.where(is_rounded, 0.5 * reach * steepness, reach - self.rounding)
        slope = np.where(is_rounded, steepness, 1.0)
        spring = self.modulus * np.where(felt > 0.0, felt, 1.0) ** (self.exponent - 1.0)
        spring /= REFERENCE_DEPTH ** (self.exponent - 1.0)
        return np.asarray(spring * felt), np.asarray(
            np.where(felt > 0.0, self.exponent * spring * slope, 0.0)
        )


SPACING = 0.75  # mm
AT_ONCE = 65_536  # nodes whose distance is measured between two steps of the progress bar
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

    def to_field(self, places: Array) -> Array:
        """Places (n, 3) of the femoral frame of poses in the field's [mm]."""
        if self.turn is None or self.shift is None:
            return places
        return np.asarray(places @ self.turn.T + self.shift)


def build_field(
    distance: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    *,
    spacing: float = SPACING,
    padding: int = PADDING,
) -> DistanceField:
    """The distance field of a surface that lies between `lower` and `upper` [mm].

    Parameters
    ----------
    distance
        Gives the signed distance [mm] of points, shape ``(n, 3)``, negative inside.
    padding
        How many cells there are around the surface; the outer three hold nothing.
    """
    # Loaded late: most fields are read from the cache.
    from scipy.ndimage import spline_filter

    origin = np.asarray(lower, float) - padding * spacing
    shape = np.ceil((np.asarray(upper) - origin) / spacing).astype(int) + padding + 1
    axes = [origin[i] + spacing * np.arange(shape[i]) for i in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    parts = [nodes[first : first + AT_ONCE] for first in range(0, len(nodes), AT_ONCE)]
    # Compiled code lets go of the interpreter, so that every core measures.
    with ThreadPoolExecutor() as threads:
        measured = threads.map(distance, parts)
        what = "measuring the femoral surface"
        found = list(progress(measured, total=len(parts), description=what))
    values = np.concatenate(found).reshape(shape)
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
