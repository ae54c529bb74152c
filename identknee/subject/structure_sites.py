"""Where structures that a model may lack run on any subject's knee.

Distances are those of a knee of typical size; `Anatomy.size` adapts them. What a source does not
give is called an estimate: it comes from the segmented ligaments of one knee [1]_ or is ours.

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

import numpy as np

from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import declared, entry
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
# A line may run so deep through the articular surface of the femur [mm].
DEEPEST = 3.0
# Points tried along a line, and how often it is moved outward at most.
SAMPLES = 41
MOVES = 20


@declared
class Site:
    """Where a line ligament would be attached."""

    name: str = entry("Name of the line, different for every line")
    femur: Array = entry(
        "Femoral insertion in the common frame of the scanned pose [mm], shape ``(3,)``"
    )
    tibia: Array = entry("Tibial insertion, likewise")
    side: CompartmentSide = entry('``"medial"`` or ``"lateral"``')

    def __post_init__(self) -> None:
        for bone in ("femur", "tibia"):
            place = frozen(getattr(self, bone), 3, name=f"the {bone} site of {self.name}")
            object.__setattr__(self, bone, place)

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
    deepest = DEEPEST * found.size
    depth = _depth_below(knee, deepest)

    def clear(site: Site, outward: Array) -> Site:
        return _cleared(site, outward, depth, deepest)

    return {
        "anterolateral": (clear(_anterolateral(knee, found), lateral),),
        "posteromedial": (clear(_posteromedial(knee, found), oblique),),
        "popliteofibular": (clear(_popliteofibular(knee, found), lateral),),
        "deep_mcl": (clear(_deep_mcl(knee, found), medial),),
        "posterior_capsule": tuple(
            clear(_posterior_capsule(knee, found, x), rear) for x in found.compartments
        ),
    }


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


def _below_rim(knee: Knee, found: Anatomy, side: Compartment, angle: float, depth: float) -> Array:
    """Place [mm] beside the rim of a plateau at `angle` [rad], `depth` [mm] below its centre."""
    frame, size = knee.tibia_frame, found.size
    rim = rim_point(side, frame, angle)
    anterior, superior, lateral = frame.axes
    away = np.cos(angle) * anterior + side.outward * np.sin(angle) * lateral
    drop = (side.plateau_centre - rim) @ superior - depth * size
    place: Array = rim + BEYOND_RIM * size * away + drop * superior
    return place


def _depth_below(knee: Knee, beside: float) -> Callable[[Site], float]:
    """A function that tells how deep a line runs below the femur's articular surface [mm].

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


def _cleared(site: Site, outward: Array, depth: Callable[[Site], float], deepest: float) -> Site:
    """The site, its femoral end moved along `outward` until the line is at most `deepest` deep."""
    for _ in range(MOVES):
        excess = depth(site) - deepest
        if excess <= 0.0:
            break
        site = replace(site, femur=site.femur + excess * outward)
    return site
