"""Points of both bones between which a line of action is sought.

Ligaments are attached beside the cartilage, where the subject's surfaces end. The bone there is
drawn from what the surfaces, the flexion axis and the known insertions tell; its shape is an
estimate.
"""

from collections.abc import Iterator

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry
from identknee.subject.anatomy import Anatomy, Compartment, anatomy, rim_point, shifted
from identknee.subject.knee import Knee
from identknee.subject.place_names import PlaceSide, sides_of

# Vertices of the femur's articular surface that are taken.
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
# where no cruciate ligament tells.
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
    femur = [*_femoral(knee, found), ("insertion", own_femur)]
    tibia = [*_tibial(knee, found), ("insertion", own_tibia)]
    return (
        _labelled(femur, condyles, knee.femur_frame.axes[2]),
        _labelled(tibia, plateaus, knee.tibia_frame.axes[2]),
    )


def _labelled(parts: list[tuple[str, Array]], centres: Array, lateral: Array) -> InsertionPoints:
    """All parts as one, each point with the side it lies on."""
    positions = np.concatenate([points for _, points in parts])
    return InsertionPoints(
        positions=positions,
        sides=tuple(sides_of(positions, centres, lateral)),
        regions=tuple(name for name, points in parts for _ in points),
    )


def _femoral(knee: Knee, found: Anatomy) -> Iterator[tuple[str, Array]]:
    yield "articular", _spread(knee.femur.vertices, ARTICULAR)
    for side in found.compartments:
        yield "epicondyle", _epicondyle(knee, found, side)
        yield "posterior condyle", _behind(knee, side)
        yield "notch", _notch(knee, found, side)


def _tibial(knee: Knee, found: Anatomy) -> Iterator[tuple[str, Array]]:
    frame, size = knee.tibia_frame, found.size
    for side in found.compartments:
        for angle in RIM_ANGLES:
            third = "anterior" if angle < 70.0 else "posterior" if angle > 110.0 else "middle"
            yield f"{third} rim", _below(knee, found, side, np.radians(angle))
    yield "intercondylar", _between_plateaus(knee, found)
    steps = np.array(
        [
            shifted(frame, (x, y, FIBULA_LEAN * max(y, 0.0)), size)
            for x in FIBULA_X
            for y in FIBULA_Y
        ]
    )
    yield "fibular head", found.fibular_head + steps


def _spread(points: Array, number: int) -> Array:
    """Some of the points, each the furthest from those before it; the first from their mean."""
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    # Rounded, so that of equally far points the first is taken wherever the knee lies.
    digits = 6 - int(np.ceil(np.log10(distance.max())))
    chosen: list[int] = []
    for _ in range(min(number, len(points))):
        chosen.append(int(np.argmax(np.round(distance, digits))))
        away = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = away if len(chosen) == 1 else np.minimum(distance, away)
    taken: Array = points[chosen]
    return taken


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
    points: Array = side.condyle_centre + steps @ knee.femur_frame.axes
    return points


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
    points: Array = middle + steps @ frame.axes
    return points


def _below(knee: Knee, found: Anatomy, side: Compartment, angle: float) -> Array:
    """Points below the rim of a plateau, inward as the tibia narrows."""
    anterior, superior, lateral = knee.tibia_frame.axes
    middle = np.mean([x.plateau_centre for x in found.compartments], axis=0)
    rim = rim_point(side, knee.tibia_frame, angle)
    outward = np.cos(angle) * anterior + side.outward * np.sin(angle) * lateral
    from_axis = rim + 2.0 * found.size * outward - middle
    from_axis = from_axis - (from_axis @ superior) * superior
    depth = np.array(DEPTHS)[:, None]
    narrowing = 1.0 - (1.0 - NARROWEST) * depth / DEPTHS[-1]
    level = (rim - middle) @ superior - found.size * depth
    points: Array = middle + narrowing * from_axis + level * superior
    return points


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
    points: Array = plateaus.mean(axis=0) + steps @ knee.tibia_frame.axes
    return points
