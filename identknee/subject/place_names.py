"""What lies near a line of action, in words of anatomy."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.arrays import Array
from identknee.subject.anatomy import Anatomy, anatomy
from identknee.subject.knee import Knee
from identknee.subject.structure_sites import structure_sites

PlaceSide = Literal["medial", "central", "lateral"]
Third = Literal["anterior", "middle", "posterior"]
Name = TypeVar("Name", bound=str)

# Distance [mm] and angle [rad] at which the weight of a structure has fallen to exp(-1/2).
NEAR_DISTANCE = 8.0
NEAR_ANGLE = np.radians(15.0)
# The weight of what has no name: that of a structure this many of these away.
UNNAMED = 2.5
ELSEWHERE = "elsewhere"
# Shares below this are left out.
LEAST_SHARE = 0.01
# Central is nearer to the middle than half the way to a plateau's centre.
CENTRAL = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """What a line of action is near to; shares sum to 1 but for those left out, largest first.

    Attributes
    ----------
    shares
        Names of structures and of the subject's own lines; ``"elsewhere"`` is what none of them
        takes.
    sides
        Where the line crosses the level of the joint line: ``"medial"``, ``"central"`` or
        ``"lateral"``.
    thirds
        Which third of the plateaus' length it crosses: ``"anterior"``, ``"middle"`` or
        ``"posterior"``.
    """

    shares: tuple[tuple[str, float], ...]
    sides: tuple[tuple[PlaceSide, float], ...]
    thirds: tuple[tuple[Third, float], ...]

    @property
    def sentence(self) -> str:
        """The place in words."""
        near = ", ".join(f"{name} {share:.2f}" for name, share in self.shares)
        return f"{self.thirds[0][0]} third, {self.sides[0][0]}: {near}"


def name_of_place(knee: Knee, femur_points: ArrayLike, tibia_points: ArrayLike) -> Place:
    """What the line through two points, or a cloud of such lines, is near to.

    A structure's weight falls with the distance of its middle from the line, which may be slid
    along itself, and with the angle between both. Shares of several lines are averaged.

    Parameters
    ----------
    knee
        The subject.
    femur_points, tibia_points
        Ends of the lines in the common frame of the scanned pose [mm], shape ``(3,)`` or
        ``(n, 3)``.

    Raises
    ------
    ValueError
        If both ends of a line coincide.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> knee = reference_knee()
    >>> mcl = knee.ligament("MCL")
    >>> name_of_place(knee, mcl.femur, mcl.tibia).shares[0][0]
    'MCL'
    """
    femur = np.asarray(femur_points, float).reshape(-1, 3)
    tibia = np.asarray(tibia_points, float).reshape(-1, 3)
    length = np.linalg.norm(tibia - femur, axis=1)
    if not length.all():
        raise ValueError("a line of action needs two different points, got the same one twice")
    found = anatomy(knee)
    direction = (tibia - femur) / length[:, None]
    weights = {ELSEWHERE: np.full(len(femur), np.exp(-0.5 * UNNAMED**2))}
    for name, middle, along in _named_lines(knee):
        distance, angle = _apart(femur, direction, middle, along)
        far = (distance / (NEAR_DISTANCE * found.size)) ** 2 + (angle / NEAR_ANGLE) ** 2
        # A structure may have several lines, and a subject's own line its name.
        weights[name] = np.maximum(weights.get(name, 0.0), np.exp(-0.5 * far))
    total = np.sum(list(weights.values()), axis=0)
    sides, thirds = _regions(knee, found, femur, tibia)
    return Place(
        shares=_ranked({name: float(np.mean(x / total)) for name, x in weights.items()}),
        sides=_ranked({x: sides.count(x) / len(sides) for x in sides}),
        thirds=_ranked({x: thirds.count(x) / len(thirds) for x in thirds}),
    )


def _ranked(shares: dict[Name, float]) -> tuple[tuple[Name, float], ...]:
    order = sorted(shares, key=lambda x: (-shares[x], x))
    return tuple((x, shares[x]) for x in order if shares[x] >= LEAST_SHARE)


def _named_lines(knee: Knee) -> Iterator[tuple[str, Array, Array]]:
    """Name, middle [mm] and unit direction of every line that has a name."""
    for ligament in knee.ligaments:
        yield ligament.name, *_middle_and_direction(ligament.femur, ligament.tibia)
    for name, sites in structure_sites(knee).items():
        for site in sites:
            yield name, *_middle_and_direction(site.femur, site.tibia)


def _middle_and_direction(femur: Array, tibia: Array) -> tuple[Array, Array]:
    return 0.5 * (femur + tibia), (tibia - femur) / np.linalg.norm(tibia - femur)


def _apart(points: Array, directions: Array, middle: Array, along: Array) -> tuple[Array, Array]:
    """Distance [mm] of a place from lines, and the angle [rad] between its direction and theirs."""
    from_line = middle - points
    from_line = from_line - (from_line * directions).sum(axis=1, keepdims=True) * directions
    across = np.linalg.norm(np.cross(directions, along), axis=1)
    angle: Array = np.arctan2(across, np.abs(directions @ along))
    return np.linalg.norm(from_line, axis=1), angle


def _regions(
    knee: Knee, found: Anatomy, femur: Array, tibia: Array
) -> tuple[list[PlaceSide], list[Third]]:
    """Side and third of the plateaus where lines come nearest to the level of the joint."""
    anterior, _, lateral = knee.tibia_frame.axes
    start, end = (knee.tibia_frame.to_local(x)[:, 1] for x in (femur, tibia))
    fall = np.where(start == end, np.inf, start - end)
    share = np.clip((start - found.joint_line) / fall, 0.0, 1.0)[:, None]
    crossing = femur + share * (tibia - femur)

    centres = np.array([x.plateau_centre for x in found.compartments])
    front = np.mean([x.anterior_margin @ anterior for x in found.compartments])
    rear = np.mean([x.posterior_margin @ anterior for x in found.compartments])
    along = (crossing @ anterior - rear) / (front - rear)
    thirds: list[Third] = [
        "posterior" if x < 1.0 / 3.0 else "anterior" if x > 2.0 / 3.0 else "middle" for x in along
    ]
    return sides_of(crossing, centres, lateral), thirds


def sides_of(points: Array, centres: Array, lateral: Array) -> list[PlaceSide]:
    """The side each of the points lies on, central between the centres of both sides ``(2, 3)``."""
    across = (points - centres.mean(axis=0)) @ lateral
    across = across / (0.5 * (centres[1] - centres[0]) @ lateral)
    return ["central" if abs(x) < CENTRAL else "lateral" if x > 0.0 else "medial" for x in across]
