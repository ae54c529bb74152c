"""Anatomical sites from a knee's surfaces, frames and insertions, whatever its ligaments' names.

Lengths from the literature, and estimates, are those of a knee whose plateaus have `TYPICAL_WIDTH`.
They are scaled with the width of the subject's plateaus.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from identknee.runs.declare import Array, array, declared, entry
from identknee.subject.knee import Frame, Knee
from identknee.subject.ligament import Ligament
from identknee.subject.surface import Surface

CompartmentSide = Literal["medial", "lateral"]

# Width of both plateaus, from the medial to the lateral rim of their cartilage [mm]; that of
# lenhart2015 is 65.8 mm.
TYPICAL_WIDTH = 66.0
# Where a condyle is nearly a sphere: angles of its normal [deg], 0 downwards and 90 backwards, and
# the largest component of the normal along the lateral axis.
POSTERIOR = (40.0, 110.0)
ACROSS = 0.5
# Bone beyond the cartilage of the femur at the epicondyles [mm], an estimate.
BEYOND_CARTILAGE = 4.0
# Offsets (anterior, superior, lateral) [mm] of collateral insertions from the epicondyle, and of
# the fibular head from the centre of the lateral plateau: means of two knees, an estimate.
COLLATERAL_FEMUR = {"medial": (1.0, 11.0, 0.0), "lateral": (0.5, 3.0, 0.0)}
FIBULAR_HEAD = (-11.0, -28.0, 26.0)
# Limits by which ligaments are recognised, in half the distance of the condyles from each other:
# collaterals insert further out than the first, cruciates further in than the second. The third is
# that of cruciates on the tibia, in half the distance of the plateaus.
OUTSIDE, BETWEEN_CONDYLES, BETWEEN_PLATEAUS = 1.35, 0.9, 0.75
# A collateral ligament reaches at least this far below the joint line [mm].
COLLATERAL_DEPTH = 15.0
# Scales over which rim points are averaged, so that a site does not jump from vertex to vertex: in
# units of a sheet's size, and an angle [rad].
SOFT_SHARE = 0.03
SOFT_RADIUS = 0.015
SOFT_ANGLE = 0.1


@declared
class Compartment:
    """Anatomical sites of one side of a knee, in the common frame of the scanned pose."""

    side: CompartmentSide = entry('``"medial"`` or ``"lateral"``')
    outward: float = entry(
        "1 where the tibial z axis points out of the knee, -1 where it points into it"
    )
    condyle_centre: Array = array(
        "Centre of the sphere that fits the posterior condyle", "axis", unit="mm"
    )
    condyle_radius: float = entry("Radius of that sphere")
    epicondyle: Array = array(
        "On the line through both condyle centres, at the width of the bone", "axis", unit="mm"
    )
    collateral_femur: Array = array(
        "Femoral insertion of the collateral ligament, the subject's own or an estimate",
        "axis",
        unit="mm",
    )
    plateau_centre: Array = array("Centre of area of the tibial surface", "axis", unit="mm")
    anterior_margin: Array = array(
        "Where the tibial surface reaches furthest forward", "axis", unit="mm"
    )
    posterior_margin: Array = array("Where it reaches furthest back", "axis", unit="mm")
    tibia: Surface = entry("The tibial surface itself")


@declared
class Anatomy:
    """Anatomical sites from the geometry of a knee."""

    size: float = entry(
        "Width of the plateaus relative to the typical one; lengths from the literature are "
        "multiplied by it"
    )
    medial: Compartment = entry("Places of the medial side")
    lateral: Compartment = entry("Places of the lateral side")
    joint_line: float = entry("Mean height of both plateau centres in the tibial frame [mm]")
    fibular_head: Array = array(
        "Tibial insertion of the lateral collateral ligament, or an estimate from the plateau, in "
        "the common frame",
        "axis",
        unit="mm",
    )
    medial_collateral: str | None = entry(
        "Name of the subject's ligament that runs like the medial collateral; None without one"
    )
    lateral_collateral: str | None = entry(
        "Name of the ligament that runs like the lateral collateral"
    )
    anterior_cruciate: str | None = entry(
        "Name of the ligament that runs like the anterior cruciate"
    )
    posterior_cruciate: str | None = entry(
        "Name of the ligament that runs like the posterior cruciate"
    )

    @property
    def compartments(self) -> tuple[Compartment, Compartment]:
        """Medial, then lateral."""
        return self.medial, self.lateral


def anatomy(knee: Knee) -> Anatomy:
    """Anatomical sites from a knee's surfaces, frames and insertions.

    The flexion axis is the line through the centres of spheres fitted to the posterior condyles
    [1]_; the anatomical epicondyles lie 6.5 mm (lateral) and 8.4 mm (medial) off it on average
    [2]_, so that what is called an epicondyle here is an estimate. Ligaments are recognised by
    where they run: collaterals outside the condyles and well below the joint line, cruciates
    between the condyles, the anterior one running forwards from the femur.

    Raises
    ------
    ValueError
        If the femoral surface has no posterior condyle on one side.

    References
    ----------
    .. [1] Yin et al. (2015), PLoS ONE 10(6), e0128877.
           https://doi.org/10.1371/journal.pone.0128877
    .. [2] Relationship between the surgical epicondylar axis and the articular surface of the
           distal femur (2008), Knee Surg Sports Traumatol Arthrosc 16(7), 674-682.
           https://doi.org/10.1007/s00167-008-0551-9

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> found = anatomy(reference_knee())
    >>> found.lateral_collateral, found.posterior_cruciate
    ('LCL', 'PCL')
    """
    anterior, _, across = knee.tibia_frame.axes
    size = float(
        ((knee.tibia[1].vertices @ across).max() - (knee.tibia[0].vertices @ across).min())
        / TYPICAL_WIDTH
    )
    plateaus = np.array([x.centroid for x in knee.tibia])
    centres, radii = zip(*(_condyle(knee, sign, plateaus) for sign in (-1.0, 1.0)), strict=True)
    roles = _roles(knee, np.array(centres), plateaus, size)
    names = roles["medial_collateral"], roles["lateral_collateral"]
    collaterals = [None if x is None else knee.ligament(x) for x in names]
    # Points of the flexion axis at the width of the femur.
    axis = centres[1] - centres[0]
    axis = axis / np.linalg.norm(axis)
    along, epicondyles = knee.femur.vertices @ axis, []
    for sign, centre, own in zip((-1.0, 1.0), centres, collaterals, strict=True):
        width = sign * (sign * along).max() + sign * BEYOND_CARTILAGE * size
        width = width if own is None else own.femur @ axis
        epicondyles.append(centre + (width - centre @ axis) * axis)
    sides: tuple[CompartmentSide, CompartmentSide] = ("medial", "lateral")
    medial, lateral = (
        Compartment(
            side=side,
            outward=sign,
            condyle_centre=centre,
            condyle_radius=radius,
            epicondyle=epicondyle,
            collateral_femur=(
                own.femur
                if own is not None
                else epicondyle + shifted(knee.femur_frame, COLLATERAL_FEMUR[side], size)
            ),
            plateau_centre=sheet.centroid,
            tibia=sheet,
            anterior_margin=_furthest(sheet, anterior),
            posterior_margin=_furthest(sheet, -anterior),
        )
        for side, sign, centre, radius, epicondyle, own, sheet in zip(
            sides, (-1.0, 1.0), centres, radii, epicondyles, collaterals, knee.tibia, strict=True
        )
    )
    fibula = (
        collaterals[1].tibia
        if collaterals[1] is not None
        else plateaus[1] + shifted(knee.tibia_frame, FIBULAR_HEAD, size)
    )
    return Anatomy(
        size=size,
        medial=medial,
        lateral=lateral,
        joint_line=float(knee.tibia_frame.to_local(plateaus)[:, 1].mean()),
        fibular_head=fibula,
        **roles,
    )


def shifted(frame: Frame, offset: tuple[float, float, float], size: float) -> Array:
    """The vector ``(anterior, superior, lateral)`` [mm] of a frame times `size`, ``(3,)``."""
    return np.asarray(size * np.array(offset) @ frame.axes)


def rim_point(compartment: Compartment, frame: Frame, angle: float) -> Array:
    """Point of a plateau's rim in the direction `angle` from its centre [mm], shape ``(3,)``.

    Parameters
    ----------
    compartment
        The side of the knee.
    frame
        The tibial frame.
    angle
        [rad], 0 forwards, pi/2 outwards, pi backwards, in units of the plateau's own length and
        width.
    """
    vertices = compartment.tibia.vertices
    local = (vertices - compartment.plateau_centre) @ frame.axes[[0, 2]].T
    local = local * [1.0, compartment.outward] / np.ptp(local, axis=0)
    away = np.cos(np.arctan2(local[:, 1], local[:, 0]) - angle) - 1.0
    # By distance rather than by open edges: a surface may be closed or have holes.
    exponent = away / SOFT_ANGLE**2 + np.linalg.norm(local, axis=1) / SOFT_RADIUS
    weights = np.exp(exponent - exponent.max())
    return np.asarray(weights @ vertices / weights.sum())


def _condyle(knee: Knee, sign: float, plateaus: Array) -> tuple[Array, float]:
    """Centre [mm] and radius [mm] of the sphere that fits a posterior condyle best by area."""
    femur, (_, _, lateral) = knee.femur, knee.femur_frame.axes
    normals = femur.normals @ knee.femur_frame.axes.T
    points = femur.vertices[femur.faces].mean(axis=1)
    angle = np.degrees(np.arctan2(-normals[:, 0], -normals[:, 1]))
    is_here = sign * ((points - plateaus.mean(axis=0)) @ lateral) > 0.0
    is_here &= (angle > POSTERIOR[0]) & (angle < POSTERIOR[1]) & (np.abs(normals[:, 2]) < ACROSS)
    if is_here.sum() < 4:
        side = "medial" if sign < 0.0 else "lateral"
        raise ValueError(
            f"the femoral surface has no posterior {side} condyle: only {is_here.sum()} triangles "
            "face backwards there; give a surface that covers it, or correct the femoral frame"
        )
    points, weights = points[is_here], np.sqrt(femur.areas[is_here])
    origin = points.mean(axis=0)
    points = points - origin
    matrix = np.c_[2.0 * points, np.ones(len(points))]
    squares = (points**2).sum(axis=1)
    solution = np.linalg.lstsq(matrix * weights[:, None], squares * weights, rcond=None)[0]
    centre = solution[:3]
    return origin + centre, float(np.sqrt(solution[3] + centre @ centre))


def _roles(knee: Knee, condyles: Array, plateaus: Array, size: float) -> dict[str, str | None]:
    """Name of the ligament that runs like each of the four collaterals and cruciates, or None."""
    anterior, superior, lateral = knee.tibia_frame.axes
    middle = plateaus.mean(axis=0)

    def on_femur(line: Ligament) -> float:
        half = 0.5 * (condyles[1] - condyles[0]) @ knee.femur_frame.axes[2]
        return float((line.femur - condyles.mean(axis=0)) @ knee.femur_frame.axes[2] / half)

    def on_tibia(line: Ligament) -> float:
        return float(
            (line.tibia - middle) @ lateral / (0.5 * (plateaus[1] - plateaus[0]) @ lateral)
        )

    def depth(line: Ligament) -> float:
        return float((middle - line.tibia) @ superior) / size

    def forwards(line: Ligament) -> float:
        return float((line.tibia - line.femur) @ anterior) / line.length

    def is_collateral(line: Ligament, sign: float) -> bool:
        is_outside = sign * on_femur(line) > OUTSIDE and sign * on_tibia(line) > 0.0
        is_behind = sign < 0.0 or (line.tibia - middle) @ anterior < 0.0
        return bool(is_outside and is_behind and depth(line) > COLLATERAL_DEPTH)

    def is_cruciate(line: Ligament, sign: float) -> bool:
        is_between = (
            abs(on_femur(line)) < BETWEEN_CONDYLES and abs(on_tibia(line)) < BETWEEN_PLATEAUS
        )
        return is_between and sign * forwards(line) > 0.0

    def best(is_like: Callable[[Ligament], bool], rank: Callable[[Ligament], float]) -> str | None:
        lines = [x for x in knee.ligaments if is_like(x)]
        return max(lines, key=rank).name if lines else None

    return {
        "medial_collateral": best(lambda x: is_collateral(x, -1.0), depth),
        "lateral_collateral": best(lambda x: is_collateral(x, 1.0), depth),
        "anterior_cruciate": best(lambda x: is_cruciate(x, 1.0), forwards),
        "posterior_cruciate": best(lambda x: is_cruciate(x, -1.0), lambda x: -forwards(x)),
    }


def _furthest(sheet: Surface, direction: Array) -> Array:
    """Where a surface reaches furthest along a unit vector [mm]: a mean of far vertices."""
    reach = sheet.vertices @ direction
    weights = np.exp((reach - reach.max()) / (SOFT_SHARE * np.ptp(reach)))
    mean = weights @ sheet.vertices / weights.sum()
    return np.asarray(mean + (reach.max() - mean @ direction) * direction)
