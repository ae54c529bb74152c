"""Cylinders and spheres that a ligament wraps around."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from identknee.runs.arrays import CHECK_UNITS, Array, frozen, implausible_coordinates
from identknee.runs.errors import ValueRefused

# A line that passes the axis at less than this share of the radius has no defined side.
ON_THE_AXIS = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Obstacle:
    """A cylinder without ends, or a sphere, fixed to a bone, that one ligament wraps around.

    Attributes
    ----------
    bone
        ``"femur"`` or ``"tibia"``.
    centre
        The centre of the sphere, or a point of the cylinder's axis, in the common frame of the
        scanned pose [mm], shape ``(3,)``.
    radius_mm
        Its radius [mm], > 0. An insertion that comes to lie inside counts as on the surface.
    axis
        Direction of the cylinder's axis, of any length, shape ``(3,)``; None for a sphere.
    side
        A direction from the axis to the side on which the ligament passes, shape ``(3,)``; None for
        the side on which the straight line between its insertions passes in the scanned pose. A
        ligament goes around a sphere the shorter way.

    Raises
    ------
    ValueError
        If a value is out of range or not finite, or a sphere has a side.
    """

    bone: Literal["femur", "tibia"]
    centre: Array
    radius_mm: float
    axis: Array | None = None
    side: Array | None = None

    def __post_init__(self) -> None:
        if self.bone not in ("femur", "tibia"):
            raise ValueRefused(f"an obstacle has the bone {self.bone!r}", "give femur or tibia")
        if not 0.0 < self.radius_mm < np.inf:
            raise ValueRefused(
                f"the radius of an obstacle must be greater than 0 mm, got {self.radius_mm:g}",
                "leave the obstacle out where the ligament is straight",
            )
        for name in ("centre", "axis", "side"):
            if getattr(self, name) is not None:
                values = frozen(getattr(self, name), 3, name=f"the {name} of an obstacle")
                if not np.isfinite(values).all() or (name != "centre" and not values.any()):
                    raise ValueRefused(
                        f"the {name} of an obstacle is {values.tolist()}", "give three numbers"
                    )
                object.__setattr__(self, name, values)
        if far := implausible_coordinates(self.centre):
            raise ValueRefused(f"the centre of an obstacle lies {far}", CHECK_UNITS)
        if self.side is not None and self.axis is None:
            raise ValueRefused(
                "an obstacle without an axis is a sphere, and a sphere has no side",
                "leave the side out: a ligament goes the shorter way",
            )

    def from_axis(self, points: Array) -> Array:
        """Vectors to points (..., 3) from the axis, or from the centre of a sphere [mm]."""
        apart = np.asarray(points) - self.centre
        if self.axis is None:
            return np.asarray(apart)
        along = self.axis / np.linalg.norm(self.axis)
        return np.asarray(apart - (apart @ along)[..., None] * along)

    def turning_axis(self, femur: Array, tibia: Array) -> Array:
        """Unit vector about which the ligament turns by the right hand; zero for a sphere.

        Parameters
        ----------
        femur, tibia
            The insertions in the common frame of the scanned pose [mm].

        Raises
        ------
        ValueError
            If the straight line runs through the axis, so that no side is nearer, or along it.
        """
        if self.axis is None:
            return np.zeros(3)
        start, end = self.from_axis(np.array([femur, tibia]))
        way = end - start
        size = float(way @ way)
        out = self.side
        if out is None:
            out = start - (start @ way / size if size else 0.0) * way
        across = float(self.axis @ np.cross(out, way))
        least = ON_THE_AXIS * self.radius_mm * np.linalg.norm(way) * np.linalg.norm(self.axis)
        if abs(across) <= least * (1.0 if self.side is None else np.linalg.norm(out)):
            raise ValueRefused(
                "the ligament runs through the axis of its obstacle or along it",
                "give a side that points from the axis to where the ligament passes",
            )
        return np.asarray(np.sign(across) * self.axis / np.linalg.norm(self.axis))

    def length_of_way(self, femur: Array, tibia: Array) -> float:
        """Length of the way between insertions in the common frame of the scanned pose [mm].

        Two tangents and an arc; around a cylinder with a rise along its axis.
        """
        axis = self.turning_axis(femur, tibia)
        start, end = self.from_axis(np.array([femur, tibia]))
        cross, dot = np.cross(start, end), float(start @ end)
        across = float(np.linalg.norm(cross) if self.axis is None else axis @ cross)
        angle = np.arctan2(across, dot)
        if angle < -0.5 * np.pi:
            angle += 2.0 * np.pi
        far = np.maximum(np.linalg.norm([start, end], axis=1), self.radius_mm)
        tangents = np.sqrt(far**2 - self.radius_mm**2)
        arc = float(angle - np.arctan2(tangents, self.radius_mm).sum())
        if arc <= 0.0:
            return float(np.linalg.norm(tibia - femur))
        return float(np.hypot(tangents.sum() + self.radius_mm * arc, (tibia - femur) @ axis))

    def mirrored(self) -> "Obstacle":
        """A copy seen in the mirror z = 0."""
        mirror = np.array([1.0, 1.0, -1.0])
        axis, side = (None if x is None else x * mirror for x in (self.axis, self.side))
        return replace(self, centre=self.centre * mirror, axis=axis, side=side)


def way_over(section: Array, span: float) -> tuple[float, Array]:
    """Length of the shortest way in a plane over what rises above a straight line.

    Parameters
    ----------
    section
        Points above the line: along it from its beginning, and up from it [mm], shape ``(n, 2)``.
    span
        Length of the line [mm].

    Returns
    -------
    length
        Of the way [mm].
    touching
        The points that it touches, from the beginning on, shape ``(k, 2)``.
    """
    if not len(section):
        return span, section
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial import ConvexHull

    corners = np.vstack([[0.0, 0.0], [span, 0.0], section])
    hull = ConvexHull(corners)
    touching = corners[np.sort(hull.vertices[hull.vertices > 1])]
    return float(hull.area) - span, touching[np.argsort(touching[:, 0])]


def circle_through(corners: Array) -> tuple[Array, float]:
    """Centre (2,) and radius of the circle through three corners ``(3, 2)``."""
    a, b, c = corners
    sides = 2.0 * np.array([b - a, c - a])
    right = np.array([b @ b - a @ a, c @ c - a @ a])
    middle = np.linalg.solve(sides, right)
    return middle, float(np.linalg.norm(a - middle))
