"""Line ligaments, what they wrap around, and groups of ligaments with tied parameters."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from identknee.runs.declare import CHECK_UNITS, Array, frozen, implausible_coordinates
from identknee.runs.errors import ValueRefused, suggestion

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ligament:
    """A line ligament.

    Attributes
    ----------
    name
        What the user calls it; parameters are named ``NAME.stiffness_kN``.
    femur, tibia
        Its insertions in the common frame of the scanned pose [mm], shape ``(3,)``.
    stiffness_kN
        Force per unit strain of its linear region [kN], >= 0.
    reference_strain_pct
        Strain in the scanned pose [%], > -100; negative for a slack ligament.
    wrap
        The cylinder or sphere that it wraps around; None where it is straight.

    Raises
    ------
    ValueError
        If a value is out of range or not finite, if both insertions coincide, or if the straight
        line runs through the axis of the obstacle, so that the side is unknown.
    """

    name: str
    femur: Array
    tibia: Array
    stiffness_kN: float  # noqa: N815 - the key in files
    reference_strain_pct: float
    wrap: Obstacle | None = None

    def __post_init__(self) -> None:
        if not self.name or self.name != self.name.strip() or set(self.name) & set(".,=\"'\n\r\t"):
            why = f"a ligament needs a name without . , = or quotes, got {self.name!r}"
            raise ValueRefused(why, "rename it")
        for bone in ("femur", "tibia"):
            where = f"the {bone} insertion of {self.name}"
            place = frozen(getattr(self, bone), 3, name=where)
            if not np.isfinite(place).all():
                raise ValueError(f"{where} must be finite numbers in mm, got {place.tolist()}")
            if far := implausible_coordinates(place):
                raise ValueRefused(f"{where} lies {far}", CHECK_UNITS)
            object.__setattr__(self, bone, place)
        if not np.any(self.tibia - self.femur):
            why = f"{self.name} has length zero: both insertions lie at {self.femur.tolist()} mm"
            raise ValueRefused(why, "give two different points")
        if self.wrap is not None:
            self.wrap.turning_axis(self.femur, self.tibia)
        if not 0.0 <= self.stiffness_kN < np.inf:
            raise ValueError(
                f"the stiffness of {self.name} must be finite and >= 0 kN, "
                f"got {self.stiffness_kN:g}"
            )
        if not -100.0 < self.reference_strain_pct < np.inf:
            raise ValueError(
                f"the reference strain of {self.name} must be finite and > -100 %, "
                f"got {self.reference_strain_pct:g}"
            )

    @property
    def length(self) -> float:
        """Length of its way between the insertions in the scanned pose [mm]."""
        if self.wrap is None:
            return float(np.linalg.norm(self.tibia - self.femur))
        return self.wrap.length_of_way(self.femur, self.tibia)

    def mirrored(self) -> "Ligament":
        """A copy seen in the mirror z = 0."""
        mirror = np.array([1.0, 1.0, -1.0])
        wrap = None if self.wrap is None else self.wrap.mirrored()
        return replace(self, femur=self.femur * mirror, tibia=self.tibia * mirror, wrap=wrap)


LEAST = 2  # members of a group
# A name, a number, and perhaps the letter of a side.
_NUMBERED = re.compile(r"(.*[^\W\d_])[-_ ]?\d+(?:[-_ ][rl])?", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class LigamentGroup:
    """Bundles with one stiffness scale and one shift of their strains; their pattern is kept.

    Attributes
    ----------
    name
        What the ligament is called; its parameters are named ``NAME.stiffness_kN``, the sum of its
        members', and ``NAME.reference_strain_pct``, their mean weighted by stiffness.
    members
        Names of the bundles.

    Raises
    ------
    ValueError
        If there are fewer than two members, or one is named twice.
    """

    name: str
    members: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        if len(self.members) < LEAST or len(set(self.members)) < len(self.members):
            raise ValueRefused(
                f"the group {self.name} must name two or more ligaments, each once",
                f"got {', '.join(self.members) or 'none'}",
            )


def groups_by_name(ligaments: Sequence[Ligament]) -> tuple[LigamentGroup, ...]:
    """Groups of ligaments whose names differ by a number at the end only, such as ``ACL2``.

    Examples
    --------
    >>> places = {"femur": [0, 9, 0], "tibia": [0, 0, 0]}
    >>> numbers = {"stiffness_kN": 1.0, "reference_strain_pct": 0.0}
    >>> names = ["ACL1", "ACL2", "LCL1_r", "LCL2_r", "PFL"]
    >>> made = groups_by_name([Ligament(name=x, **places, **numbers) for x in names])
    >>> [(x.name, x.members) for x in made]
    [('ACL', ('ACL1', 'ACL2')), ('LCL', ('LCL1_r', 'LCL2_r'))]
    """
    taken = {x.name for x in ligaments}
    members: dict[str, list[str]] = {}
    for ligament in ligaments:
        numbered = _NUMBERED.fullmatch(ligament.name)
        if numbered and numbered[1] not in taken and ligament.stiffness_kN > 0.0:
            members.setdefault(numbered[1], []).append(ligament.name)
    return tuple(
        LigamentGroup(name=name, members=tuple(own))
        for name, own in members.items()
        if len(own) >= LEAST
    )


def check_groups(groups: Sequence[LigamentGroup], ligaments: Sequence[Ligament]) -> None:
    """Refuse groups that the ligaments do not allow.

    Raises
    ------
    ValueError
        If a member is not a ligament or is in two groups, if no member of a group has a stiffness,
        or if a group has the name of a ligament or of another group.
    """
    stiffness = {x.name: x.stiffness_kN for x in ligaments}
    seen: set[str] = set()
    taken = set(stiffness)
    for group in groups:
        if group.name in taken:
            why = f"a ligament or another group is also called {group.name}"
            raise ValueRefused(why, "rename it")
        taken.add(group.name)
        for member in group.members:
            if member not in stiffness:
                raise ValueError(
                    f"the group {group.name} names the ligament {member!r}, which the knee does "
                    f"not have. {suggestion(member, list(stiffness))}"
                )
            if member in seen:
                why = f"the ligament {member} is in two groups"
                raise ValueRefused(why, "leave it in one of them")
            seen.add(member)
        if not sum(stiffness[x] for x in group.members) > 0.0:
            raise ValueRefused(
                f"no ligament of the group {group.name} has a stiffness above 0",
                "give one to its members, whose shares are kept",
            )
