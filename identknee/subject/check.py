"""Checks of a knee's geometry, each finding one sentence with its remedy."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
from typing_extensions import override

from identknee.mechanics.pose import angles_of
from identknee.runs.declare import Array, IntArray, declared, entry
from identknee.runs.findings import Finding, Severity, by_severity, finding
from identknee.runs.triangles import lengths, longest_sides, side_names
from identknee.runs.words import listed_first
from identknee.subject.femoral_distance import distance_to_femur
from identknee.subject.knee import (
    Knee,
    angle_between,
    ankle_centre,
    frames_from_landmarks,
    joint_centre,
)
from identknee.subject.ligament import Ligament
from identknee.subject.surface import Surface

# A dimension of a knee below this number was given in metres, not in mm.
METRES = 1.0
# Landmarks from hip to ankle that are all closer than this number were given in metres.
LEG_IN_METRES = 2.0
# A femur smaller than the first [mm] was given in cm or inches; no surface or ligament of a knee is
# longer than the second.
LEAST_FEMUR, LONGEST = 25.0, 1000.0
# Surfaces that share more than this part of the smaller one's vertices are one surface given twice.
SHARED = 0.5
# A ligament farther than this on the other side of the joint, or a cruciate of the other, [mm] is
# wrongly named.
WRONG_BY = 10.0
# A femoral insertion farther than this below the tibial one [mm] is on the other bone: at no angle
# of flexion does one of a knee come so low.
BELOW = 5.0
# Insertions farther than this from the articular surface of their bone [mm] are no knee's. Those of
# the subjects that come with identknee lie up to 25 mm from it on the femur, 62 mm on the tibia.
FARTHEST_INSERTION = {"femur": 60.0, "tibia": 110.0}
# Cruciates insert further in than this, in half the distance of the plateaus, and run forwards or
# backwards by more than this share of their length; the posterior capsule does not.
BETWEEN_PLATEAUS, RUNS = 0.9, 0.25
MOST_LISTED = 3
# Plausible size of the femoral surface and length of a ligament [mm].
FEMUR_EXTENT = (40.0, 200.0)
LIGAMENT_LENGTH = (5.0, 200.0)
# Largest plausible gap and overlap of the cartilages in the scanned pose [mm].
WIDEST_GAP = 3.0
DEEPEST_OVERLAP = 4.0
# Stiffness [kN] above which a warning is given; stiffness and strain [%] that no ligament has.
ODD_STIFFNESS, IMPOSSIBLE_STIFFNESS, IMPOSSIBLE_STRAIN = 100.0, 1000.0, 100.0
# If no strain exceeds this [%], strains were probably given as fractions.
LARGEST_FRACTION = 0.2
FARTHEST_ORIGIN = 150.0  # mm, of a frame from the joint surface
LANDMARK_ANGLE = 5.0  # deg, between an axis of a frame and that of the landmarks
NEAR_DUPLICATE = 1e-4  # mm, between vertices that should be one
SLIVER = 1e-3  # height of a degenerate triangle over its longest edge
# Flexion, varus and internal rotation [deg] of a scanned knee lie within these.
SCANNED_ANGLES = {"flexion": (-20.0, 150.0), "varus": (-20.0, 20.0), "internal": (-45.0, 45.0)}
# The condyles curl up behind, and the trochlea does not in front. So triangles whose normals have
# an upward component above UPWARD lie behind the centre of the whole surface. They count if they
# make LEAST_UPWARD_SHARE of its area, and are anterior if in front by FORWARD_SHARE of its length.
UPWARD = 0.5
LEAST_UPWARD_SHARE = 0.005
FORWARD_SHARE = 0.1


@declared
class GeometryFinding(Finding):
    """A finding of a geometry check."""

    where: str = entry("What it is about, such as a surface or a ligament", key="subject")
    remedy: str = entry("What to do about it; empty where there is nothing to do")

    @property
    @override
    def line(self) -> str:
        """As a terminal shows it."""
        return f"{self.severity.prefix}{self.where}: {self.sentence} {self.remedy}".rstrip()


def geometry_finding(
    code: str,
    where: str,
    sentence: str,
    values: Mapping[str, Any] | None = None,
    *,
    remedy: str | None = None,
) -> GeometryFinding:
    """A finding of a registered kind about a knee."""
    made = finding(code, where, values, sentence=sentence)
    return GeometryFinding(
        code=code,
        severity=made.severity,
        where=where,
        sentence=sentence,
        values=made.values,
        remedy=made.kind.remedy if remedy is None else remedy,
    )


def check_geometry(knee: Knee) -> tuple[GeometryFinding, ...]:
    """Everything found about surfaces, their contact, ligaments and frames; errors first."""
    return tuple(by_severity([*fatal_geometry_findings(knee), *_other_findings(knee)]))


@lru_cache(maxsize=8)
def geometry_warnings(knee: Knee) -> tuple[Finding, ...]:
    """What a check of the knee warns of, as every result that rests on the knee repeats it."""
    return tuple(
        finding(x.code, x.where, x.values, sentence=f"{x.where}: {x.sentence} {x.remedy}".rstrip())
        for x in by_severity(_other_findings(knee))
        if x.severity is Severity.WARNING
    )


def fatal_geometry_findings(knee: Knee) -> tuple[GeometryFinding, ...]:
    """Errors that make the knee unusable; fast enough for every reading."""
    # Metres make the other tests meaningless, and so does a wrong side.
    return (
        tuple(_same_surfaces(knee))
        or tuple(_metres(knee))
        or tuple(_impossible(knee))
        or tuple(_wrong_side(knee))
        or tuple(_flipped_surfaces(knee))
        or tuple(_insertions_elsewhere(knee))
        or tuple(_exchanged_ligaments(knee))
        or tuple(_mirrored_ligaments(knee))
        or tuple(_exchanged_cruciates(knee))
    )


def _other_findings(knee: Knee) -> Iterator[GeometryFinding]:
    """Findings about a knee without fatal errors."""
    for name, surface in _surfaces(knee):
        yield from _surface_findings(name, surface)
    yield from _contact_findings(knee)
    yield from _ligament_findings(knee)
    yield from _frame_findings(knee)
    yield from _landmark_findings(knee)


def _surfaces(knee: Knee) -> tuple[tuple[str, Surface], ...]:
    medial, lateral = knee.tibia
    return (("femur", knee.femur), ("tibia_medial", medial), ("tibia_lateral", lateral))


def _same_surfaces(knee: Knee) -> Iterator[GeometryFinding]:
    """Surfaces that are, or hold, one another: vertices are compared as files store them."""
    # Adding zero turns -0.0 into 0.0.
    places = {x: y.vertices.astype(np.float32) + np.float32(0.0) for x, y in _surfaces(knee)}
    for one, other in combinations(places, 2):
        small, large = sorted((one, other), key=lambda x: len(places[x]))
        share = _shared(places[small], places[large])
        if share == 1.0 and len(places[small]) == len(places[large]):
            sentence = f"{one} and {other} are the same surface."
            yield geometry_finding("surfaces-same", other, sentence, {"same_as": one})
        elif share > SHARED:
            sentence = f"It holds the surface of {small} as well."
            yield geometry_finding("surfaces-same", large, sentence, {"same_as": small})


def _shared(some: Any, others: Any) -> float:
    """Share of the places (n, 3) that are among others (m, 3); 0 where it is at most `SHARED`."""
    if np.isin(some[:, 0], others[:, 0]).mean() <= SHARED:
        return 0.0
    known = set(map(tuple, others.tolist()))
    return float(np.mean([tuple(x) in known for x in some.tolist()]))


def _metres(knee: Knee) -> Iterator[GeometryFinding]:
    apart = [
        float(np.linalg.norm(a.position - b.position)) for a, b in combinations(knee.landmarks, 2)
    ]
    sizes = [
        *((x, extent(y), METRES, "The surface is only {} mm across") for x, y in _surfaces(knee)),
        *((_of(x), x.length, METRES, "It is only {} mm long") for x in knee.ligaments),
        ("landmarks", max(apart, default=np.inf), LEG_IN_METRES, "They are at most {} mm apart"),
    ]
    for where, size, least, words in sizes:
        if size < least:
            sentence = f"{words.format(f'{size:.3g}')}; lengths are in mm."
            yield geometry_finding("in-metres", where, sentence, {"size_mm": size})
    femur = extent(knee.femur)
    if METRES <= femur < LEAST_FEMUR:
        sentence = f"The surface is only {femur:.3g} mm across; lengths are in mm."
        remedy = "If these are cm, multiply by 10; if inches, by 25.4."
        yield geometry_finding("in-metres", "femur", sentence, {"size_mm": femur}, remedy=remedy)
    for where, size, _, _ in sizes[: 3 + len(knee.ligaments)]:
        if size > LONGEST:
            sentence = f"It is {size:.0f} mm long; lengths are in mm."
            remedy = "If these are micrometres, divide by 1000; else remove what is far away."
            yield geometry_finding("in-metres", where, sentence, {"size_mm": size}, remedy=remedy)


def _of(ligament: Ligament) -> str:
    return f"ligament {ligament.name}"


def _impossible(knee: Knee) -> Iterator[GeometryFinding]:
    for ligament in knee.ligaments:
        stiffness, strain = ligament.stiffness_kN, ligament.reference_strain_pct
        if stiffness > IMPOSSIBLE_STIFFNESS:
            sentence = f"Its stiffness is {stiffness:g} kN per unit strain."
            values = {"stiffness_kN": stiffness}
            yield geometry_finding("stiffness-impossible", _of(ligament), sentence, values)
        if abs(strain) > IMPOSSIBLE_STRAIN:
            sentence = f"Its reference strain is {strain:g} %."
            values = {"reference_strain_pct": strain}
            yield geometry_finding("strain-impossible", _of(ligament), sentence, values)


def _wrong_side(knee: Knee) -> Iterator[GeometryFinding]:
    other = "left" if knee.side == "right" else "right"
    medial, lateral = knee.tibia
    across = (lateral.centroid - medial.centroid) @ knee.tibia_frame.axes[2]
    is_upturned = _is_anterior_upturned(knee)
    known = {x.name: x.position for x in knee.landmarks}
    is_against = False
    if {"medial_epicondyle", "lateral_epicondyle"} <= set(known):
        line = known["lateral_epicondyle"] - known["medial_epicondyle"]
        is_against = bool(line @ (lateral.centroid - medial.centroid) < 0.0)
    # The epicondyles, and not the files of the plateaus, are the wrong way round.
    if is_against and is_upturned:
        yield geometry_finding(
            "epicondyles-exchanged",
            "landmarks",
            "The medial epicondyle lies above tibia_lateral, and the lateral one above "
            "tibia_medial, so that the femur faces backwards.",
        )
    elif across <= 0.0:
        yield geometry_finding(
            "wrong-side",
            "side",
            f"For a {knee.side} knee, tibia_medial lies {-across:.1f} mm to the lateral side of "
            "tibia_lateral.",
            {"side": knee.side, "across_mm": across},
            remedy=f'Write side = "{other}" if it is a {other} knee; else exchange the two files '
            "or correct the axes of the tibial frame.",
        )
    elif is_upturned:
        yield geometry_finding(
            "wrong-side",
            "side",
            f"For a {knee.side} knee, the rounded back of the femoral condyles points forwards.",
            {"side": knee.side},
            remedy=f'Write side = "{other}" if it is a {other} knee; else exchange the medial and '
            "lateral landmarks or turn the femoral axes, x forwards and z to the subject's right.",
        )


def _is_anterior_upturned(knee: Knee) -> bool:
    """Whether the part of the femur that faces upward is anterior to the rest."""
    femur, axes = knee.femur, knee.femur_frame.axes
    # The test must hold for normals that all point inward, too: the next test finds these.
    normals = femur.normals * np.sign(-_upward_facing(knee.femur, knee.tibia, axes[1]))
    upward = normals @ axes[1] > UPWARD
    area = femur.areas[upward].sum()
    if area < LEAST_UPWARD_SHARE * femur.areas.sum():
        return False
    centres = femur.vertices[femur.faces].mean(axis=1) @ axes[0]
    offset = femur.areas[upward] @ centres[upward] / area - femur.centroid @ axes[0]
    return bool(offset > FORWARD_SHARE * np.ptp(femur.vertices @ axes[0]))


def _upward_facing(surface: Surface, others: Iterable[Surface], superior: Array) -> float:
    """Mean upward component of a surface's normals where it is closest to the others."""
    return float(np.mean([facing_normals(surface, x) @ superior for x in others]))


def _flipped_surfaces(knee: Knee) -> Iterator[GeometryFinding]:
    """Surfaces whose normals point the wrong way where the bones face each other."""
    superior = knee.tibia_frame.axes[1]
    up = {"femur": -_upward_facing(knee.femur, knee.tibia, superior)}
    for name, surface in _surfaces(knee)[1:]:
        up[name] = _upward_facing(surface, [knee.femur], superior)
    for name, component in up.items():
        if component < 0.0:
            sentence = "Its normals point into the bone where it faces the joint."
            yield geometry_finding("normals-inward", name, sentence, {"upward": component})


def _away(knee: Knee, bone: str) -> dict[str, float]:
    """How far the insertion of each ligament on a bone is from its articular surface [mm]."""
    surfaces = (knee.femur,) if bone == "femur" else knee.tibia
    vertices = np.vstack([x.vertices for x in surfaces])
    return {
        x.name: float(np.linalg.norm(vertices - getattr(x, bone), axis=1).min())
        for x in knee.ligaments
    }


def _insertions_elsewhere(knee: Knee) -> Iterator[GeometryFinding]:
    """Bones all of whose insertions are far away: they were given in another frame."""
    for bone, farthest in FARTHEST_INSERTION.items():
        nearest = min(_away(knee, bone).values(), default=0.0)
        if nearest > farthest:
            sentence = f"No insertion on the {bone} is nearer to its surface than {nearest:.0f} mm."
            values = {"bone": bone, "nearest_mm": nearest}
            yield geometry_finding("insertions-elsewhere", "ligaments", sentence, values)


COLLATERALS = {"MCL": ("mcl", "smcl", "dmcl"), "LCL": ("lcl", "fcl")}


def _exchanged_ligaments(knee: Knee) -> Iterator[GeometryFinding]:
    """Ligaments whose ends are on the other bone, and collaterals on the other side."""
    up = knee.tibia_frame.axes[1]
    if knee.ligaments and all((x.femur - x.tibia) @ up < 0.0 for x in knee.ligaments):
        sentence = "All femoral insertions lie below the tibial ones."
        remedy = "Exchange femur and tibia of all ligaments."
        yield geometry_finding("ligaments-exchanged", "ligaments", sentence, remedy=remedy)
        return
    for ligament in knee.ligaments:
        below = float((ligament.tibia - ligament.femur) @ up)
        if below > BELOW:
            sentence = f"Its femoral insertion lies {below:.0f} mm below the tibial one."
            values, remedy = {"below_mm": below}, "Exchange its femur and tibia."
            where = _of(ligament)
            yield geometry_finding("ligaments-exchanged", where, sentence, values, remedy=remedy)
    medial, lateral = (x.centroid for x in knee.tibia)
    across = (lateral - medial) / np.linalg.norm(lateral - medial)
    middle = (lateral + medial) / 2.0
    for name, sign in (("MCL", -1.0), ("LCL", 1.0)):
        own = [x for x in knee.ligaments if x.name.lower().startswith(COLLATERALS[name])]
        ends = [(x.femur + x.tibia) / 2.0 for x in own]
        off = sign * float((np.mean(ends, axis=0) - middle) @ across) if ends else 0.0
        if off < -WRONG_BY:
            side = "lateral" if name == "MCL" else "medial"
            sentence = f"The {name} lies {-off:.0f} mm to the {side} side of the joint's middle."
            yield geometry_finding("ligaments-exchanged", _of(own[0]), sentence, {"off_mm": -off})


def _mirrored_ligaments(knee: Knee) -> Iterator[GeometryFinding]:
    """Insertions of the other side's knee, whatever the names of the ligaments are.

    Between the condyles a ligament that runs forwards from the femur comes from the lateral one,
    and one that runs backwards from the medial one. A mirror, whichever its plane, reverses that.
    """
    anterior, lateral = knee.tibia_frame.axes[0], knee.tibia_frame.axes[2]
    middle = np.mean([x.centroid for x in knee.tibia], axis=0)
    inside = BETWEEN_PLATEAUS * abs((knee.tibia[0].centroid - middle) @ lateral)

    def runs(ligament: Ligament) -> float:
        return float((ligament.tibia - ligament.femur) @ anterior) / ligament.length

    between = [
        x
        for x in knee.ligaments
        if max(abs((x.femur - middle) @ lateral), abs((x.tibia - middle) @ lateral)) < inside
    ]
    forwards = [x for x in between if runs(x) > RUNS]
    backwards = [x for x in between if runs(x) < -RUNS]
    if not (forwards and backwards):
        return
    # Means, since in deep flexion lines of the capsule run as steeply as cruciates do.
    front, back = (np.mean([x.femur for x in own], axis=0) for own in (forwards, backwards))
    off = float((back - front) @ lateral)
    if off > WRONG_BY:
        other = "left" if knee.side == "right" else "right"
        names = [tuple(x.name for x in own) for own in (forwards, backwards)]
        first, second = (listed_first(x, MOST_LISTED) for x in names)
        sentence = (
            f"What runs forwards from the femur ({first}) begins {off:.0f} mm further medially "
            f"than what runs backwards ({second}), as in a {other} knee."
        )
        values = {"forwards": names[0], "backwards": names[1], "off_mm": off}
        yield geometry_finding("ligaments-mirrored", "ligaments", sentence, values)


def _exchanged_cruciates(knee: Knee) -> Iterator[GeometryFinding]:
    """Cruciates by their names, of which the posterior one inserts in front on the tibia."""
    names = {x.name: x.name.lower() for x in knee.ligaments}
    places = [
        [x.tibia for x in knee.ligaments if own in names[x.name] and other not in names[x.name]]
        for own, other in (("acl", "pcl"), ("pcl", "acl"))
    ]
    if not all(places):
        return
    front, back = (np.mean(x, axis=0) for x in places)
    off = float((back - front) @ knee.tibia_frame.axes[0])
    if off > WRONG_BY:
        first = next(x for x in knee.ligaments if "acl" in names[x.name])
        sentence = f"On the tibia the ACL inserts {off:.0f} mm behind the PCL."
        remedy = "Exchange the names of ACL and PCL."
        values = {"off_mm": off}
        where = _of(first)
        yield geometry_finding("ligaments-exchanged", where, sentence, values, remedy=remedy)


def _surface_findings(name: str, surface: Surface) -> Iterator[GeometryFinding]:
    if clauses := surface.repairs.clauses:
        mended = surface.repairs
        values = {x: getattr(mended, x) for x in ("without_area", "twice", "turned", "unused")}
        sentence = f"Mended on reading: {'; '.join(clauses)}."
        yield geometry_finding("surface-repaired", name, sentence, values)
    if surface.is_closed:
        sentence = "The surface is closed: it has a bone side as well."
        yield geometry_finding("surface-closed", name, sentence)
    if len(holes := hole_sizes(surface)):
        have = "is a hole" if len(holes) == 1 else f"are {len(holes)} holes"
        sentence = f"Within the surface there {have}, up to {holes.max():.2g} mm across."
        values = {"n": len(holes), "largest_mm": holes.max()}
        yield geometry_finding("surface-holes", name, sentence, values)
    counted = (
        ("winding-inconsistent", count_inconsistent_edges(surface)),
        ("edges-shared", count_shared_edges(surface)),
        ("vertices-near-duplicate", count_near_duplicates(surface, NEAR_DUPLICATE)),
        ("triangles-degenerate", count_slivers(surface, SLIVER)),
    )
    for code, n in counted:
        if n:
            yield geometry_finding(code, name, _COUNTED[code].format(n), {"n": n})


_COUNTED = {
    "winding-inconsistent": "At {} edges neighbouring triangles face opposite ways.",
    "edges-shared": "{} edges belong to more than two triangles.",
    "vertices-near-duplicate": f"{{}} pairs of vertices are closer than {NEAR_DUPLICATE:g} mm but "
    "not the same.",
    "triangles-degenerate": "{} triangles are degenerate: they have hardly any area.",
}


def _contact_findings(knee: Knee) -> Iterator[GeometryFinding]:
    femur = knee.femur

    def to_femur(points: Array) -> Array:
        return distance_to_femur(femur, knee.femur_frame)(knee.femur_frame.to_local(points))

    distance = knee.femur_distance or to_femur
    for name, surface in _surfaces(knee)[1:]:
        depth = overlap_of(surface, distance)
        # What lies far behind an open sheet counts as deep within it.
        gap = 0.0 if 0.0 < depth <= DEEPEST_OVERLAP else gap_between(femur, surface)
        if gap > WIDEST_GAP:
            sentence = f"In the scanned pose it is {gap:.1f} mm away from the femur."
            yield geometry_finding("surfaces-apart", name, sentence, {"gap_mm": gap})
            continue
        if depth > DEEPEST_OVERLAP:
            sentence = f"In the scanned pose it reaches {depth:.1f} mm into the femur."
            yield geometry_finding("surfaces-overlap", name, sentence, {"depth_mm": depth})
        else:
            state = f"overlaps the femur by {depth:.2f} mm" if depth > 0 else f"is {gap:.2f} mm off"
            sentence = f"In the scanned pose it {state}."
            values = {"gap_mm": gap, "depth_mm": depth}
            yield geometry_finding("surface-contact", name, sentence, values)


def _ligament_findings(knee: Knee) -> Iterator[GeometryFinding]:
    shortest, longest = LIGAMENT_LENGTH
    far = {bone: _away(knee, bone) for bone in FARTHEST_INSERTION}
    for ligament in knee.ligaments:
        where, length, stiffness = _of(ligament), ligament.length, ligament.stiffness_kN
        if not shortest <= length <= longest:
            sentence = f"It is {length:.1f} mm long in the scanned pose."
            yield geometry_finding("ligament-length-odd", where, sentence, {"length_mm": length})
        else:
            for bone, farthest in FARTHEST_INSERTION.items():
                away = far[bone][ligament.name]
                if away > farthest:
                    sentence = f"Its insertion on the {bone} is {away:.0f} mm from its surface."
                    values = {"bone": bone, "away_mm": away}
                    yield geometry_finding("insertion-far", where, sentence, values)
        if wrap := ligament.wrap:
            for bone in ("femur", "tibia"):
                off = float(np.linalg.norm(wrap.from_axis(getattr(ligament, bone))))
                if off < wrap.radius_mm:
                    depth = wrap.radius_mm - off
                    sentence = f"Its insertion on the {bone} is {depth:.1f} mm inside its obstacle."
                    values = {"depth_mm": depth}
                    yield geometry_finding("insertion-inside-obstacle", where, sentence, values)
        if ODD_STIFFNESS < stiffness <= IMPOSSIBLE_STIFFNESS:
            sentence = f"Its stiffness is {stiffness:g} kN per unit strain."
            yield geometry_finding("stiffness-odd", where, sentence, {"stiffness_kN": stiffness})
        elif stiffness == 0.0:
            sentence = "Its stiffness is zero, so that it carries nothing."
            yield geometry_finding("stiffness-zero", where, sentence)
    strains = np.abs([x.reference_strain_pct for x in knee.ligaments])
    if strains.any() and strains.max() <= LARGEST_FRACTION:
        sentence = f"No reference strain exceeds {strains.max():g} %."
        values = {"largest_pct": strains.max()}
        yield geometry_finding("strains-as-fractions", "ligaments", sentence, values)


def _frame_findings(knee: Knee) -> Iterator[GeometryFinding]:
    size = extent(knee.femur)
    least, most = FEMUR_EXTENT
    if not least <= size <= most:
        sentence = f"The surface is {size:.0f} mm across, unlike the articular surface of a knee."
        yield geometry_finding("femur-size-odd", "femur", sentence, {"size_mm": size})
    rotation = knee.femur_frame.axes @ knee.tibia_frame.axes.T
    angles = np.degrees(angles_of(rotation))
    for (name, (low, high)), angle in zip(SCANNED_ANGLES.items(), angles, strict=True):
        if not low <= angle <= high:
            sentence = f"In the scanned pose the {name} angle is {angle:.0f} deg."
            values = {"angle": name, "angle_deg": angle}
            yield geometry_finding("scanned-angle-odd", "frames", sentence, values)
    for bone, frame, surface in (
        ("femur", knee.femur_frame, knee.femur),
        ("tibia", knee.tibia_frame, knee.tibia[0]),
    ):
        away = float(np.linalg.norm(frame.origin - surface.centroid))
        if away > FARTHEST_ORIGIN:
            sentence = f"Its origin is {away:.0f} mm away from the joint surface."
            yield geometry_finding("origin-far", f"{bone} frame", sentence, {"away_mm": away})


def _landmark_findings(knee: Knee) -> Iterator[GeometryFinding]:
    for bone, axis, angle in _landmark_angles(knee):
        if angle > LANDMARK_ANGLE:
            sentence = f"Its {axis} axis is {angle:.1f} deg off the one that the landmarks define."
            values = {"axis": axis, "off_deg": angle}
            yield geometry_finding("axis-off-landmarks", f"{bone} frame", sentence, values)


def _landmark_angles(knee: Knee) -> Iterator[tuple[str, str, float]]:
    """Bone, axis and its angle [deg] to what the landmarks say, as far as they say it."""
    places = {x.name: x.position for x in knee.landmarks}
    frames = {"femur": knee.femur_frame, "tibia": knee.tibia_frame}
    try:
        defined = frames_from_landmarks(places)
    except ValueError:
        # Long axes only; frame origins replace missing epicondyles.
        centre, ankle = joint_centre(places), ankle_centre(places)
        for bone, far, sign in (("femur", places.get("hip_centre"), 1.0), ("tibia", ankle, -1.0)):
            if far is not None:
                near = frames[bone].origin if centre is None else centre
                yield bone, "superior", angle_between(frames[bone].axes[1], sign * (far - near))
        return
    for (bone, given), made in zip(frames.items(), defined, strict=True):
        for row, axis in ((1, "superior"), (2, "lateral")):
            yield bone, axis, angle_between(given.axes[row], made.axes[row])


# Triangles of the closest tenth show how two surfaces face each other where they are in contact.
CLOSEST_SHARE = 0.1
# Larger surfaces are sampled at this many triangles or vertices, drawn at random. Hundreds of them
# lie where two bones face each other, and only the sign of their mean normal is used.
LOOKED_AT = 5_000


def count_inconsistent_edges(surface: Surface) -> int:
    """How many edges two triangles run through in the same direction: one is wound wrongly."""
    start, end = surface.faces, np.roll(surface.faces, -1, axis=1)
    # Whole numbers sort many times as fast as pairs of them.
    _, count = np.unique(start * len(surface.vertices) + end, return_counts=True)
    return int((count > 1).sum())


def count_shared_edges(surface: Surface) -> int:
    """How many edges belong to three triangles or more."""
    names = side_names(surface.faces, len(surface.vertices))
    return int((np.unique(names, return_counts=True)[1] > 2).sum())


def hole_sizes(surface: Surface) -> Array:
    """How wide the holes of a surface are [mm], ``(n,)``: its rims but the widest of each part.

    A hole that touches the outer rim at a corner is one rim with it, and is no hole.
    """
    # Loaded late: it takes longer than a simulation.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, rim = len(surface.vertices), surface.boundary_edges

    def parts(one: IntArray, other: IntArray) -> IntArray:
        links = coo_array((np.ones(len(one), bool), (one, other)), shape=(n, n))
        return np.asarray(connected_components(links, directed=False)[1])

    on, degree = np.unique(rim, return_counts=True)
    loops, loop, count = np.unique(parts(*rim.T)[on], return_inverse=True, return_counts=True)
    middle = np.stack([np.bincount(loop, x) / count for x in surface.vertices[on].T], axis=1)
    widths = np.zeros(len(loops))
    np.maximum.at(widths, loop, 2.0 * lengths(surface.vertices[on] - middle[loop]))
    part = np.empty(len(loops), np.int64)
    part[loop] = parts(surface.faces[:, [0, 1]].ravel(), surface.faces[:, [1, 2]].ravel())[on]
    order = np.lexsort((-widths, part))
    # The free edges of a third triangle at an edge are no closed line.
    is_hole = np.bincount(loop, degree % 2)[order] == 0
    is_hole &= np.diff(part[order], prepend=-1) == 0
    return np.asarray(widths[order][is_hole])


def count_near_duplicates(surface: Surface, tolerance: float) -> int:
    """How many pairs of vertices lie within `tolerance` [mm] of each other."""
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial import cKDTree

    return len(cKDTree(surface.vertices).query_pairs(tolerance))


def count_slivers(surface: Surface, thinness: float) -> int:
    """How many triangles have a height less than `thinness` times their longest edge."""
    longest = longest_sides(surface.vertices, surface.faces)
    return int((2.0 * surface.areas <= thinness * longest**2).sum())


def extent(surface: Surface) -> float:
    """Diagonal of its bounding box [mm]."""
    return float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))


def facing_normals(surface: Surface, other: Surface) -> Array:
    """Mean normal of `surface` where it is closest to `other`, shape ``(3,)``."""
    from scipy.spatial import cKDTree

    # Far from a fine surface many of its vertices are about as near, which makes a search slow.
    looked, near = _looked_at(len(surface.faces)), _looked_at(len(other.vertices))
    centres = surface.vertices[surface.faces[looked]].mean(axis=1)
    distance = cKDTree(other.vertices[near]).query(centres)[0]
    is_close = distance <= np.quantile(distance, CLOSEST_SHARE)
    weights, normals = surface.areas[looked][is_close], surface.normals[looked][is_close]
    mean: Array = weights @ normals / max(weights.sum(), np.finfo(float).tiny)
    return mean


def _looked_at(n: int) -> IntArray:
    """Indices of the triangles or vertices, of `n`, that are sampled."""
    if n <= LOOKED_AT:
        return np.arange(n)
    return np.random.default_rng(0).choice(n, LOOKED_AT, replace=False)


def gap_between(one: Surface, other: Surface) -> float:
    """Smallest distance of two surfaces [mm], 0 where they touch or cross."""
    # Loaded late, as it takes longer than a simulation.
    import fcl

    from identknee.mechanics.mesh_contact import collision_hierarchy

    bodies = [fcl.CollisionObject(collision_hierarchy(x.vertices, x.faces)) for x in (one, other)]
    if fcl.collide(*bodies, fcl.CollisionRequest(), fcl.CollisionResult()) > 0:
        return 0.0
    return max(float(fcl.distance(*bodies, fcl.DistanceRequest(), fcl.DistanceResult())), 0.0)


def overlap_of(surface: Surface, distance: Callable[[Array], Array]) -> float:
    """How deep the vertices of a surface lie within another at most [mm], 0 if none does.

    Parameters
    ----------
    surface
        The surface.
    distance
        Gives the signed distance [mm] of points from the other, shape ``(n, 3)``, negative within.
    """
    return max(float(-distance(surface.vertices).min()), 0.0)
