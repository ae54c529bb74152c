"""Line ligaments, and groups of ligaments with tied parameters."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.runs.arrays import CHECK_UNITS, Array, frozen, implausible_coordinates
from identknee.runs.errors import ValueRefused, suggestion
from identknee.subject.obstacle import Obstacle


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
