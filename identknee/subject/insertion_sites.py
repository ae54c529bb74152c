"""Insertion sites of structures, names of places on the bones, and where ligaments can be attached.

Distances are those of a knee of typical size; `Anatomy.size` scales them. What no source gives is
called an estimate. It comes from the segmented ligaments of one knee [1]_ or is ours.

Ligaments are attached beside the cartilage, where the subject's surfaces end. The bone there is
drawn from what the surfaces, the flexion axis and the known insertions imply; its shape is an
estimate.

References
----------
.. [1] Lenhart et al. (2015), Ann Biomed Eng 43(11), 2675-2685.
       https://doi.org/10.1007/s10439-015-1326-3
.. [2] Claes et al. (2013), J Anat 223(4), 321-328. https://doi.org/10.1111/joa.12087
.. [3] Kennedy et al. (2015), Am J Sports Med 43(7), 1606-1615.
       https://doi.org/10.1177/0363546515578253
.. [4] Rezansoff et al. (2015), Knee Surg Sports Traumatol Arthrosc 23(11), 3196-3201.
       https://doi.org/10.1007/s00167-014-3126-y
.. [5] LaPrade et al. (2007), J Bone Joint Surg Am 89(9), 2000-2010.
       https://doi.org/10.2106/JBJS.F.01176
.. [6] LaPrade et al. (2003), Am J Sports Med 31(6), 854-860.
       https://doi.org/10.1177/03635465030310062101
.. [7] Osti et al. (2013), Orthopedics 36(9).
       https://doi.org/10.3928/01477447-20130821-11
.. [8] Liu et al. (2010), J Orthop Surg Res 5, 69. https://doi.org/10.1186/1749-799X-5-69
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.declare import Array, array, declared, entry
from identknee.subject.anatomy import (
    Anatomy,
    Compartment,
    CompartmentSide,
    anatomy,
    rim_point,
    shifted,
)
from identknee.subject.knee import Knee

# Bone beyond the cartilage at the rim of a plateau [mm], an estimate.
BEYOND_RIM = 2.0
# Largest depth of a line below the articular surface of the femur [mm].
DEEPEST = 3.0
# Points along a line at which its depth is evaluated, and the most moves outward.
SAMPLES = 41
MOVES = 20


@declared
class Site:
    """A site of a line ligament."""

    name: str = entry("Name of the line, different for every line")
    femur: Array = array(
        "Femoral insertion in the common frame of the scanned pose", "axis", unit="mm"
    )
    tibia: Array = array("Tibial insertion, likewise", "axis", unit="mm")
    side: CompartmentSide = entry('``"medial"`` or ``"lateral"``')

    @property
    def length(self) -> float:
        """Distance of its insertions in the scanned pose [mm]."""
        return float(np.linalg.norm(self.tibia - self.femur))


def structure_sites(knee: Knee) -> dict[str, tuple[Site, ...]]:
    """The lines of each structure by its name.

    A line that would run through a condyle is moved outward until it is at most 3 mm deep.

    Raises
    ------
    ValueError
        If the femoral surface has no posterior condyle on one side.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> sites = structure_sites(reference_knee())
    >>> [len(lines) for lines in sites.values()]
    [1, 1, 1, 1, 2]
    """
    found = anatomy(knee)
    lateral, medial = knee.tibia_frame.axes[2], -knee.tibia_frame.axes[2]
    rear = -knee.tibia_frame.axes[0]
    oblique = (medial + rear) / np.sqrt(2.0)
    clear = _clear_of_condyles(knee, found)
    return {
        "anterolateral": (clear(_anterolateral(knee, found), lateral),),
        "posteromedial": (clear(_posteromedial(knee, found), oblique),),
        "popliteofibular": (clear(_popliteofibular(knee, found), lateral),),
        "deep_mcl": (clear(_deep_mcl(knee, found), medial),),
        "posterior_capsule": tuple(
            clear(_posterior_capsule(knee, found, x), rear) for x in found.compartments
        ),
    }


def capsule_sites(knee: Knee) -> dict[str, tuple[Site, ...]]:
    """Three lines of each sheet of the capsule, by its name.

    The posteromedial sheet reaches from the posterior oblique ligament to behind the medial
    condyle, the posterolateral one from behind the lateral condyle to its outer side, and the
    anterolateral one lies 6 mm to either side of the anterolateral ligament on the tibia and 3 mm
    on the femur, all estimates. A line that would run through a condyle is moved outward.

    Raises
    ------
    ValueError
        If the femoral surface has no posterior condyle on one side.
    """
    found = anatomy(knee)
    lateral, rear = knee.tibia_frame.axes[2], -knee.tibia_frame.axes[0]
    inner, outer = (_posterior_capsule(knee, found, x) for x in (found.medial, found.lateral))
    ligament, anterior = _anterolateral(knee, found), found.size * knee.tibia_frame.axes[0]
    sheets = {
        "posteromedial": (_posteromedial(knee, found), inner, rear - lateral),
        "posterolateral": (outer, _posterolateral(knee, found), rear + lateral),
        "anterolateral": (
            _shifted_site(ligament, -3.0 * anterior, -6.0 * anterior),
            _shifted_site(ligament, 3.0 * anterior, 6.0 * anterior),
            lateral,
        ),
    }
    clear = _clear_of_condyles(knee, found)
    return {
        name: tuple(
            clear(_between(name, one, other, share), outward / np.linalg.norm(outward))
            for share in (0.0, 0.5, 1.0)
        )
        for name, (one, other, outward) in sheets.items()
    }


def _shifted_site(site: Site, femur: Array, tibia: Array) -> Site:
    return replace(site, femur=site.femur + femur, tibia=site.tibia + tibia)


def _between(name: str, one: Site, other: Site, share: float) -> Site:
    """A line between two, at a share of the way to the other."""
    return Site(
        name=name,
        femur=(1.0 - share) * one.femur + share * other.femur,
        tibia=(1.0 - share) * one.tibia + share * other.tibia,
        side=one.side,
    )


def _clear_of_condyles(knee: Knee, found: Anatomy) -> Callable[[Site, Array], Site]:
    """A function that moves a line outward until it runs at most 3 mm deep through a condyle."""
    deepest = DEEPEST * found.size
    depth = _depth_below(knee, deepest)

    def clear(site: Site, outward: Array) -> Site:
        for _ in range(MOVES):
            excess = depth(site) - deepest
            if excess <= 0.0:
                break
            site = replace(site, femur=site.femur + excess * outward)
        return site

    return clear


def _anterolateral(knee: Knee, found: Anatomy) -> Site:
    """From behind and above the lateral collateral to between Gerdy's tubercle and the fibula.

    Femur 4.7 mm behind and above the lateral collateral's insertion [3]_ (5.4 mm in one variant of
    [4]_, in front of it in [2]_ and the other variant); tibia midway between Gerdy's tubercle and
    the front of the fibular head [2]_, 9.5 mm below the joint line [3]_ (11.5 mm in [4]_). That the
    tubercle is 4 mm in front of the cartilage of the lateral plateau is an estimate; the front of
    the fibular head is 8.2 mm before the collateral's insertion [6]_.
    """
    side, size, frame = found.lateral, found.size, knee.tibia_frame
    anterior = frame.axes[0]
    gerdy = side.anterior_margin @ anterior + 4.0 * size
    fibula = found.fibular_head @ anterior + 8.2 * size
    forwards = 0.5 * (gerdy + fibula) - side.plateau_centre @ anterior
    half = 0.5 * (side.anterior_margin - side.posterior_margin) @ anterior
    angle = float(np.arccos(np.clip(forwards / half, -0.9, 0.9)))
    return Site(
        name="anterolateral",
        femur=side.collateral_femur + shifted(knee.femur_frame, (-3.3, 3.3, 0.0), size),
        tibia=_below_rim(knee, found, side, angle, 9.5),
        side="lateral",
    )


def _posteromedial(knee: Knee, found: Anatomy) -> Site:
    """From behind the medial epicondyle to the posteromedial rim.

    The posterior oblique ligament starts 7.7 mm below and 6.4 mm behind the adductor tubercle [5]_,
    which puts it about 10 mm behind the superficial medial collateral ligament; in [1]_ it starts
    as far behind, but 20 mm lower. Between the two, 8 mm behind and 4 mm above the flexion axis, is
    an estimate, as is its tibial end 10 mm below the joint line (13 mm in [1]_).
    """
    side, size = found.medial, found.size
    return Site(
        name="posteromedial",
        femur=side.epicondyle + shifted(knee.femur_frame, (-8.0, 4.0, 3.0), size),
        tibia=_below_rim(knee, found, side, np.radians(140.0), 10.0),
        side="medial",
    )


def _popliteofibular(knee: Knee, found: Anatomy) -> Site:
    """From the popliteus insertion on the femur to the back of the fibular head.

    The popliteus is inserted in front of and below the lateral collateral ligament: 18.5 mm from it
    in [6]_, 7.6 mm (5.7 below, 5.0 in front) in [7]_, 9.5 mm in [1]_; 4 mm in front and 9 mm
    below is an estimate. The fibular end is at the styloid [6]_: 9 mm behind, 10 mm above and 8 mm
    medial to the collateral's insertion is an estimate from [1]_.
    """
    side, size = found.lateral, found.size
    return Site(
        name="popliteofibular",
        femur=side.collateral_femur + shifted(knee.femur_frame, (4.0, -9.0, 0.0), size),
        tibia=found.fibular_head + shifted(knee.tibia_frame, (-9.0, 10.0, -8.0), size),
        side="lateral",
    )


def _deep_mcl(knee: Knee, found: Anatomy) -> Site:
    """From below the superficial medial collateral's insertion to the rim beneath.

    The femoral end is 10.6 mm below the superficial ligament's, the tibial end 6.5 mm below the
    joint line [8]_.
    """
    side, size = found.medial, found.size
    return Site(
        name="deep_mcl",
        femur=side.collateral_femur + shifted(knee.femur_frame, (0.0, -10.6, 0.0), size),
        tibia=_below_rim(knee, found, side, np.radians(90.0), 6.5),
        side="medial",
    )


def _posterior_capsule(knee: Knee, found: Anatomy, side: Compartment) -> Site:
    """From behind and above a condyle to the posterior rim of its plateau.

    The capsule wraps the condyle; a straight line stands for its free part, from the rear of the
    condyle 0.7 of its radius above the flexion axis to 11 mm below the joint line (12 mm in [1]_),
    an estimate.
    """
    radius = side.condyle_radius
    return Site(
        name=f"posterior_capsule_{side.side}",
        femur=side.condyle_centre + shifted(knee.femur_frame, (-0.9, 0.7, 0.0), radius),
        tibia=_below_rim(knee, found, side, np.radians(180.0), 11.0),
        side=side.side,
    )


def _posterolateral(knee: Knee, found: Anatomy) -> Site:
    """From behind and above the lateral condyle's outer half to the posterolateral rim.

    The outer edge of the posterior capsule with the arcuate complex, an estimate: 0.8 of the
    condyle's radius behind, 0.6 above and 0.5 lateral to its centre.
    """
    side = found.lateral
    return Site(
        name="posterolateral",
        femur=side.condyle_centre
        + shifted(knee.femur_frame, (-0.8, 0.6, 0.5), side.condyle_radius),
        tibia=_below_rim(knee, found, side, np.radians(145.0), 10.0),
        side="lateral",
    )


def _below_rim(knee: Knee, found: Anatomy, side: Compartment, angle: float, depth: float) -> Array:
    """Place [mm] beside the rim of a plateau at `angle` [rad], `depth` [mm] below its centre."""
    frame, size = knee.tibia_frame, found.size
    rim = rim_point(side, frame, angle)
    anterior, superior, lateral = frame.axes
    away = np.cos(angle) * anterior + side.outward * np.sin(angle) * lateral
    drop = (side.plateau_centre - rim) @ superior - depth * size
    return np.asarray(rim + BEYOND_RIM * size * away + drop * superior)


def _depth_below(knee: Knee, beside: float) -> Callable[[Site], float]:
    """A function for how deep a line runs below the femur's articular surface [mm].

    Points further than `beside` [mm] past the rim of the surface do not count.
    """
    centres, normals = knee.femur.vertices[knee.femur.faces].mean(axis=1), knee.femur.normals
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial import cKDTree

    tree = cKDTree(centres)
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]

    def depth(site: Site) -> float:
        points = (1.0 - share) * site.femur + share * site.tibia
        distance, nearest = tree.query(points)
        height = ((points - centres[nearest]) * normals[nearest]).sum(axis=1)
        aside = np.sqrt(np.maximum(distance**2 - height**2, 0.0))
        return float(np.where(aside < beside, -height, 0.0).max())

    return depth


PlaceSide = Literal["medial", "central", "lateral"]
Third = Literal["anterior", "middle", "posterior"]
Name = TypeVar("Name", bound=str)

# The weight of a structure falls with its distance [mm] and angle [rad] to a line of action as a
# Gaussian with these standard deviations.
NEAR_DISTANCE = 8.0
NEAR_ANGLE = np.radians(15.0)
# Nameless places have the weight of a structure this many standard deviations away.
UNNAMED = 2.5
ELSEWHERE = "elsewhere"
# Shares below this are left out.
LEAST_SHARE = 0.01
# Central places are nearer to the middle than this share of the way to a plateau's centre.
CENTRAL = 0.5


@declared
class Place:
    """What a line of action is near to; shares sum to 1 but for those left out, largest first."""

    shares: tuple[tuple[str, float], ...] = entry(
        'Names of structures and of the subject\'s own lines; ``"elsewhere"`` is what none of '
        "them takes"
    )
    sides: tuple[tuple[PlaceSide, float], ...] = entry(
        'Where the line crosses the level of the joint line: ``"medial"``, ``"central"`` or '
        '``"lateral"``'
    )
    thirds: tuple[tuple[Third, float], ...] = entry(
        'Which third of the plateaus\' length it crosses: ``"anterior"``, ``"middle"`` or '
        '``"posterior"``'
    )

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
    lines = [(x.name, x.femur, x.tibia) for x in knee.ligaments]
    for name, sites in structure_sites(knee).items():
        lines += [(name, x.femur, x.tibia) for x in sites]
    for name, start, end in lines:
        along = (end - start) / np.linalg.norm(end - start)
        distance, angle = _apart(femur, direction, 0.5 * (start + end), along)
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


# Vertices of the femur's articular surface among the points.
ARTICULAR = 60
# Around an epicondyle: how far it reaches from the flexion axis forwards, backwards, up and down
# [mm], how far points are apart, and at which distance the bone is as wide as its cartilage.
EPICONDYLE_X, EPICONDYLE_Y = (-21.0, 21.0), (-14.0, 21.0)
SPACING = 7.0
DOME = 28.0
# Behind a condyle: angles on its sphere [deg], 90 backwards and 180 up, and places across in radii.
REAR_ANGLES = (95.0, 115.0, 135.0, 155.0)
REAR_ACROSS = (-0.4, 0.0, 0.4)
# The walls of the notch from the flexion axis [mm], and across in half distances of the condyles
# where there is no cruciate ligament.
NOTCH_X, NOTCH_Y = (-14.0, 10.0), (-10.0, 8.0)
NOTCH_ACROSS = 0.45
# Angles around the plateaus [deg] and depths below their rims [mm]. Downwards the tibia narrows:
# in linear measure to this share at the last depth.
RIM_ANGLES = (5.0, 30.0, 55.0, 80.0, 105.0, 130.0, 155.0, 180.0)
DEPTHS = (2.0, 9.0, 17.0, 25.0, 34.0, 43.0, 52.0, 60.0)
NARROWEST = 0.55
# Between the plateaus: places along in halves of their length, across in half their distance, and
# how much lower the bone is behind [mm].
SPINE_ALONG = (-1.05, -0.7, -0.35, 0.0, 0.35, 0.7, 1.0)
SPINE_ACROSS = (-0.4, 0.0, 0.4)
REAR_DROP = 10.0
# Around the fibular head: anterior, superior and lateral steps [mm].
FIBULA_X, FIBULA_Y = (-9.0, -3.0, 3.0), (-7.0, -1.0, 5.0, 11.0)
FIBULA_LEAN = -0.6


@declared
class InsertionPoints:
    """Points of one bone to which a line may be attached."""

    positions: Array = array(
        "Places in the common frame of the scanned pose", "point", "axis", unit="mm"
    )
    sides: tuple[PlaceSide, ...] = entry('``"medial"``, ``"central"`` or ``"lateral"`` for each')
    regions: tuple[str, ...] = entry(
        'The part of the bone each belongs to, such as ``"epicondyle"`` or ``"fibular head"``'
    )


def insertion_surfaces(knee: Knee) -> tuple[InsertionPoints, InsertionPoints]:
    """Points of the femur, and of tibia and fibula, about 200 each.

    The subject's own insertions are among them, as the region ``"insertion"``.

    Raises
    ------
    ValueError
        If the femoral surface has no posterior condyle on one side.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> femur, tibia = insertion_surfaces(reference_knee())
    >>> femur.positions.shape[1], sorted(set(tibia.sides))
    (3, ['central', 'lateral', 'medial'])
    """
    found = anatomy(knee)
    own_femur = np.array([x.femur for x in knee.ligaments]).reshape(-1, 3)
    own_tibia = np.array([x.tibia for x in knee.ligaments]).reshape(-1, 3)
    condyles = np.array([x.condyle_centre for x in found.compartments])
    plateaus = np.array([x.plateau_centre for x in found.compartments])
    femur = [("articular", _spread(knee.femur.vertices, ARTICULAR))]
    tibia = []
    for side in found.compartments:
        femur += [
            ("epicondyle", _epicondyle(knee, found, side)),
            ("posterior condyle", _behind(knee, side)),
            ("notch", _notch(knee, found, side)),
        ]
        for angle in RIM_ANGLES:
            third = "anterior" if angle < 70.0 else "posterior" if angle > 110.0 else "middle"
            tibia.append((f"{third} rim", _below(knee, found, side, np.radians(angle))))
    around_fibula = [
        shifted(knee.tibia_frame, (x, y, FIBULA_LEAN * max(y, 0.0)), found.size)
        for x in FIBULA_X
        for y in FIBULA_Y
    ]
    femur.append(("insertion", own_femur))
    tibia += [
        ("intercondylar", _between_plateaus(knee, found)),
        ("fibular head", found.fibular_head + np.array(around_fibula)),
        ("insertion", own_tibia),
    ]
    return (
        _labelled(femur, condyles, knee.femur_frame.axes[2]),
        _labelled(tibia, plateaus, knee.tibia_frame.axes[2]),
    )


def _labelled(parts: list[tuple[str, Array]], centres: Array, lateral: Array) -> InsertionPoints:
    positions = np.concatenate([points for _, points in parts])
    return InsertionPoints(
        positions=positions,
        sides=tuple(sides_of(positions, centres, lateral)),
        regions=tuple(name for name, points in parts for _ in points),
    )


def _spread(points: Array, number: int) -> Array:
    """`number` of the points by farthest-point sampling, the first the furthest from their mean."""
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    # Rounded, so that of equally far points the first is taken wherever the knee lies.
    digits = 6 - int(np.ceil(np.log10(distance.max())))
    chosen: list[int] = []
    for _ in range(min(number, len(points))):
        chosen.append(int(np.argmax(np.round(distance, digits))))
        away = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = away if len(chosen) == 1 else np.minimum(distance, away)
    return np.asarray(points[chosen])


def _epicondyle(knee: Knee, found: Anatomy, side: Compartment) -> Array:
    """A dome from the width of the cartilage to the collateral ligament's."""
    frame, size = knee.femur_frame, found.size
    lateral = side.outward * frame.axes[2]
    widest = max(side.epicondyle @ lateral, side.collateral_femur @ lateral)
    bulge = max(widest - float((knee.femur.vertices @ lateral).max()), 0.0)
    along, up = np.meshgrid(
        np.arange(*EPICONDYLE_X, SPACING) + 0.5 * SPACING,
        np.arange(*EPICONDYLE_Y, SPACING) + 0.5 * SPACING,
    )
    steps = np.c_[along.ravel(), up.ravel(), np.zeros(along.size)] * size
    sunk = bulge * np.minimum((along**2 + up**2) / DOME**2, 1.0).ravel()
    points: Array = side.epicondyle + steps @ frame.axes
    points += (widest - points @ lateral - sunk)[:, None] * lateral
    return points


def _behind(knee: Knee, side: Compartment) -> Array:
    """The condyle's cylinder above and behind its cartilage."""
    angle, across = (x.ravel() for x in np.meshgrid(np.radians(REAR_ANGLES), REAR_ACROSS))
    steps = side.condyle_radius * np.c_[-np.sin(angle), -np.cos(angle), across]
    return np.asarray(side.condyle_centre + steps @ knee.femur_frame.axes)


def _notch(knee: Knee, found: Anatomy, side: Compartment) -> Array:
    """The wall of the notch, as far from the middle as the cruciate ligament it holds."""
    frame, size = knee.femur_frame, found.size
    name = found.anterior_cruciate if side.side == "lateral" else found.posterior_cruciate
    middle = np.mean([x.condyle_centre for x in found.compartments], axis=0)
    half = abs((side.condyle_centre - middle) @ frame.axes[2])
    across = side.outward * NOTCH_ACROSS * half
    if name is not None:
        across = (knee.ligament(name).femur - middle) @ frame.axes[2]
    along, up = np.meshgrid(
        np.arange(*NOTCH_X, SPACING) + 0.5 * SPACING, np.arange(*NOTCH_Y, SPACING) + 0.5 * SPACING
    )
    steps = np.c_[size * along.ravel(), size * up.ravel(), np.full(along.size, across)]
    return np.asarray(middle + steps @ frame.axes)


def _below(knee: Knee, found: Anatomy, side: Compartment, angle: float) -> Array:
    """Points below the rim of a plateau, inward as the tibia narrows."""
    anterior, superior, lateral = knee.tibia_frame.axes
    middle = np.mean([x.plateau_centre for x in found.compartments], axis=0)
    rim = rim_point(side, knee.tibia_frame, angle)
    outward = np.cos(angle) * anterior + side.outward * np.sin(angle) * lateral
    from_axis = rim + BEYOND_RIM * found.size * outward - middle
    from_axis = from_axis - (from_axis @ superior) * superior
    depth = np.array(DEPTHS)[:, None]
    narrowing = 1.0 - (1.0 - NARROWEST) * depth / DEPTHS[-1]
    level = (rim - middle) @ superior - found.size * depth
    return np.asarray(middle + narrowing * from_axis + level * superior)


def _between_plateaus(knee: Knee, found: Anatomy) -> Array:
    """The bone between the plateaus, lower behind, raised or lowered to the cruciate ligaments."""
    anterior, _, lateral = knee.tibia_frame.axes
    plateaus = np.array([x.plateau_centre for x in found.compartments])
    half_width = 0.5 * (plateaus[1] - plateaus[0]) @ lateral
    half_length = 0.5 * np.mean(
        [(x.anterior_margin - x.posterior_margin) @ anterior for x in found.compartments]
    )
    along, across = (x.ravel() for x in np.meshgrid(SPINE_ALONG, SPINE_ACROSS))
    steps = np.c_[half_length * along, np.zeros(along.size), half_width * across]
    steps[:, 1] = -REAR_DROP * found.size * np.maximum(-along, 0.0) ** 2
    for name in (found.anterior_cruciate, found.posterior_cruciate):
        if name is not None:
            own = knee.tibia_frame.axes @ (knee.ligament(name).tibia - plateaus.mean(axis=0))
            squares = ((steps - own)[:, [0, 2]] ** 2).sum(axis=1) / (SPACING * found.size) ** 2
            steps[:, 1] += np.exp(-0.5 * squares) * (own[1] - steps[:, 1])
    return np.asarray(plateaus.mean(axis=0) + steps @ knee.tibia_frame.axes)
