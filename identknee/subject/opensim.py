"""Knees of OpenSim models that describe contact and ligaments as OpenSim JAM does.

What of a model has no place in a knee is listed (`left_out_of`).
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from identknee.runs.declare import Array, BoolArray, declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, whatever_case
from identknee.runs.words import capitalised
from identknee.subject.check import fatal_geometry_findings
from identknee.subject.examples import opensim_file
from identknee.subject.knee import BONES, Frame, Knee, Landmark, Side
from identknee.subject.ligament import Ligament, Obstacle, groups_by_name
from identknee.subject.opensim_model import (
    LIGAMENT_CLASS,
    MM_PER_M,
    Element,
    Joint,
    OsimModel,
    Transform,
)
from identknee.subject.opensim_wrap import (
    OTHER_OBJECT,
    SEVERAL,
    Wrapping,
    wrap_objects,
    wrapping_of,
)
from identknee.subject.surface import Surface, joined, read_surface

MESH_CLASSES = ("Smith2018ContactMesh", "ContactMesh")
CONTACT_LAW = "contact follows the law of identknee, not the modulus and thickness of the model"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bones:
    """The joint of a knee, and where its bodies are in the joint's parent frame [m]."""

    model: OsimModel
    joint: Joint
    side: Side
    femur: dict[str, Transform]
    tibia: dict[str, Transform]
    tibia_frame: Transform


def contact_meshes(model: OsimModel) -> list[Element]:
    """The contact meshes of a model."""
    return [x for kind in MESH_CLASSES for x in model.all_of(kind)]


def bones_of(model: OsimModel, side: Side | None = None) -> Bones:
    """The joint of the model's knee with contact meshes, and its bodies.

    Parameters
    ----------
    model
        The model.
    side
        Which knee, where it has two; also the side of a knee whose names do not state one.

    Raises
    ------
    InputError
        If there is no such knee, or more than one.
    """
    carriers = {model.placed(x.findtext("socket_frame", ""))[0] for x in contact_meshes(model)}
    bodies = {}
    for bone in BONES:
        found = sorted(x for x in carriers if bone in x.lower())
        sides = {side_in(x) for x in found} - {None}
        if side is not None:
            found = [x for x in found if side_in(x) in (side, None)]
        if len(found) != 1:
            of_side = "" if side is None else f"{side} "
            remedy = f"Give a model of one knee whose {bone} has this name and a contact mesh."
            if side is None and len(sides) > 1:
                remedy = "Choose one with --side left or --side right."
            elif side is not None and sides:
                remedy = f"Give another side than --side {side}."
            raise model.refusal(
                "contact geometry",
                f"one {of_side}{bone} with a contact mesh is wanted, found "
                f"{', '.join(found) or 'none'}",
                remedy,
            )
        bodies[bone] = found
    femora, tibiae = bodies["femur"], bodies["tibia"]
    femoral, tibial = model.welded(femora[0]), model.welded(tibiae[0])
    for joint in model.joints:
        if joint.parent in femoral and joint.child in tibial:
            break
    else:
        raise model.refusal(
            "joints",
            f"no joint leads from {femora[0]} to {tibiae[0]}",
            "Only knees with one joint between femur (its parent) and tibia are supported.",
        )
    to_parent = (femoral[joint.parent] @ joint.parent_frame).inverse
    tibia_frame = model.displacement(joint)
    to_child = tibia_frame @ (tibial[joint.child] @ joint.child_frame).inverse
    return Bones(
        model=model,
        joint=joint,
        side=_side(model, side, femora[0], joint.name, tibiae[0]),
        femur={name: to_parent @ place for name, place in femoral.items()},
        tibia={name: to_child @ place for name, place in tibial.items()},
        tibia_frame=tibia_frame,
    )


def side_in(name: str) -> Side | None:
    """The side that a name of the model states; None where it states none.

    Examples
    --------
    >>> side_in("femur_distal_r"), side_in("leftTibia"), side_in("femur")
    ('right', 'left', None)
    """
    word = r"(?:^|[_\-. ])(r|right|l|left)(?:[_\-. ]|$)"
    found = re.search(word, name.lower()) or re.search("(right|left)", name.lower())
    if found is None:
        return None
    return "right" if found[1].startswith("r") else "left"


def _side(model: OsimModel, stated: Side | None, *names: str) -> Side:
    for name in names:
        if (found := side_in(name)) is not None:
            return found
    if stated is not None:
        return stated
    raise model.refusal(
        "bodies",
        f"neither of {', '.join(names)} says which side it is of",
        "Let the name of the femur end with _r or _l, or state --side.",
    )


# Elements that hold a path, by version of OpenSim.
PATH_POINTS = ".//PathPointSet/objects/*"
# Elements of a force that name its bodies.
BODY_TAGS = re.compile(r"socket_\w+|(body|frame)_?[12ab]?", re.IGNORECASE)
POINT_TO_POINT = "PointToPoint"
# Least stiffness of all ligaments together [kN], and least distance of a ligament's ends as a share
# of its slack length.
LEAST_STIFFNESS, SHORTEST = 0.5, 0.5
TRANSITION_STRAIN = 0.06
# Beginnings of the names of bundles that make one line of each ligament. The first that occurs is
# taken, so that the deep and posterior bundles of the medial collateral stay out of its line. All
# bundles of the others belong to theirs, and the name may begin with the bundle, as in aACL.
MERGED = {"ACL": ("ACL",), "PCL": ("PCL",), "LCL": ("LCL",), "MCL": ("MCLs", "sMCL", "MCL")}
WHOLE = ("ACL", "PCL", "LCL")


Change = Literal["left out", "changed"]


@declared
class NotTaken:
    """Elements of a model that the knee leaves out or changes."""

    kind: str = entry("Class of it in the model")
    names: tuple[str, ...] = entry("Names there")
    change: Change = entry("Whether it is left out or changed")
    why: str = entry("What became of it and why, as a clause")
    is_line: bool = entry("Whether it is a ligament between femur and tibia", default=False)


@declared
class OsimEnd:
    """An attachment of a ligament to a bone."""

    element: Element = entry("The XML of its point")
    frame: Transform = entry("Where the frame in which that is given is in the common frame [m]")


@declared
class OsimLine:
    """A ligament between femur and tibia, with the XML it was read from."""

    ligament: Ligament = entry("What it is here, on the side that the model is of")
    element: Element = entry("Its XML")
    ends: Mapping[str, OsimEnd] = entry("Its femoral and its tibial end, by bone")


def ends_of(bones: Bones, element: Element) -> dict[str, OsimEnd]:
    """First and last point of a path, by the bone of this knee to which it is attached."""
    points = element.findall(PATH_POINTS)
    ends: dict[str, OsimEnd] = {}
    for point in (points[0], points[-1]) if len(points) > 1 else ():
        body, frame = bones.model.placed(point.findtext("socket_parent_frame", ""))
        for bone, bodies in (("femur", bones.femur), ("tibia", bones.tibia)):
            if body in bodies:
                ends[bone] = OsimEnd(element=point, frame=bodies[body] @ frame)
    return ends


def is_off(element: Element) -> bool:
    """Whether a force is switched off in the model."""
    applies = (element.findtext("appliesForce") or "").strip().lower()
    disabled = (element.findtext("isDisabled") or "").strip().lower()
    return applies in ("false", "0") or disabled in ("true", "1")


FITTED = "a cylinder replaces the ellipsoid they wrap around; lengths are up to {:.2g} mm off"
AS_ASKED = "straight lines replace paths that wrap, as asked"
MERGED_STRAIGHT = "the merged lines are straight, their bundles wrap"
OTHER_TOE = f"the transition strain {TRANSITION_STRAIN:g} replaces that of the model"
CONDITIONAL = "ends that hold in a range of a coordinate alone are taken as fixed"
OFF = "their force is switched off in the model (appliesForce false or isDisabled true)"
CONTACT_OFF = "its force is switched off in the model, and here contact acts nevertheless"
MOVING = "an end moves along its bone, and only fixed ends are read"


def lines_of(bones: Bones, *, wrapping: bool = True) -> tuple[list[OsimLine], list[NotTaken]]:
    """The ligaments between femur and tibia, and those not taken or not taken exactly.

    Without `wrapping` all lines are straight.

    Raises
    ------
    InputError
        If there is none, or one cannot be used.
    """
    model = bones.model
    lines: list[OsimLine] = []
    reasons = (OFF, MOVING, SEVERAL, OTHER_OBJECT, AS_ASKED, FITTED, OTHER_TOE, CONDITIONAL)
    remarks: dict[str, list[str]] = {x: [] for x in reasons}
    objects = wrap_objects(model, {"femur": bones.femur, "tibia": bones.tibia})
    worst = 0.0
    for element in model.all_of(LIGAMENT_CLASS):
        ends, name = ends_of(bones, element), element.get("name", "")
        if len(ends) < 2:
            continue
        kinds = {end.element.tag for end in ends.values()}
        if is_off(element) or "MovingPathPoint" in kinds:
            remarks[OFF if is_off(element) else MOVING].append(name)
            continue
        places = {x: end.frame(model.vector(end.element, "location")) for x, end in ends.items()}
        way = wrapping_of(model, element, objects, *(places[x] * MM_PER_M for x in BONES))
        if way.obstacle is not None and not wrapping:
            way = Wrapping(obstacle=None, why_straight=AS_ASKED)
        ligament = _ligament(model, element, places, way.obstacle)
        lines.append(OsimLine(ligament=ligament, element=element, ends=ends))
        if way.why_straight:
            remarks[way.why_straight].append(name)
        if np.isfinite(way.error_mm):
            remarks[FITTED].append(name)
            worst = max(worst, way.error_mm)
        if model.numbers(element, "transition_strain", "0.06")[0] != TRANSITION_STRAIN:
            remarks[OTHER_TOE].append(name)
        if "ConditionalPathPoint" in kinds:
            remarks[CONDITIONAL].append(name)
    if not lines:
        off = [*remarks[OFF], *remarks[MOVING]]
        why = f"no {LIGAMENT_CLASS} leads from the femur to the tibia"
        if others := sorted({x.tag for x in other_ligaments(bones)}):
            why = f"{why}: its ligaments are of class {' and '.join(others)}, which are not read"
        remedy = f"Give a model whose ligaments are of class {LIGAMENT_CLASS}."
        if off:
            why = f"all of class {LIGAMENT_CLASS} are switched off or have a moving end"
            remedy = "Switch on those that the knee has (appliesForce true), with fixed ends."
        raise model.refusal("forces", why, remedy)
    called = [x.ligament.name for x in lines]
    if twice := next((x for x in called if called.count(x) > 1), ""):
        why = "another ligament between femur and tibia has this name"
        raise model.refusal(f"ligament {twice}", why, "Remove it from the model, or rename it.")
    total = sum(x.ligament.stiffness_kN for x in lines)
    if 0.0 < total < LEAST_STIFFNESS:
        why = f"all ligaments together have a linear_stiffness of {1000.0 * total:.3g} N"
        raise model.refusal("forces", why, "If these are kN, multiply by 1000.")
    return lines, [
        NotTaken(
            kind=LIGAMENT_CLASS,
            names=tuple(names),
            change="left out" if why in (OFF, MOVING) else "changed",
            why=why.format(worst),
            is_line=True,
        )
        for why, names in remarks.items()
        if names
    ]


def other_ligaments(bones: Bones) -> list[Element]:
    """Forces along a path from this femur to this tibia that are of no class that is read."""
    return [
        x
        for x in bones.model.forces
        if x.tag != LIGAMENT_CLASS and not is_muscle(x) and _joins_the_bones(bones, x)
    ]


def _joins_the_bones(bones: Bones, force: Element) -> bool:
    """Whether a force pulls along a line between this femur and this tibia."""
    if POINT_TO_POINT not in force.tag or force.find(PATH_POINTS) is not None:
        return set(ends_of(bones, force)) == {"femur", "tibia"}
    bodies = _bodies_of(bones, force)
    return all(bodies & set(own) for own in (bones.femur, bones.tibia))


def unread_names(bones: Bones, not_taken: Sequence[NotTaken]) -> list[str]:
    """Names of the ligaments between femur and tibia that the model has and that are not read."""
    left_out = [name for x in not_taken if x.change == "left out" for name in x.names]
    left_out += [
        x.get("name", "") for x in bones.model.all_of(LIGAMENT_CLASS) if x.find(PATH_POINTS) is None
    ]
    return left_out + [x.get("name", "") for x in other_ligaments(bones)]


def is_muscle(force: Element) -> bool:
    """Whether a force is that of a muscle."""
    return "Muscle" in force.tag or force.find("max_isometric_force") is not None


def merged(
    model: OsimModel, ligaments: Sequence[Ligament], missing: Sequence[str] = ()
) -> list[Ligament]:
    """The four single lines, each from the bundles whose names begin with its own.

    Parameters
    ----------
    model
        Where they come from.
    ligaments
        The bundles.
    missing
        Names of bundles that the model has, but that are not read. A line all of whose bundles are
        such is left out.

    Raises
    ------
    InputError
        If one of them has no bundle in the model.
    """
    lines = []
    for name in MERGED:
        bundle = bundle_names(name, ligaments, missing)
        if bundle:
            lines.append(line_for(name, bundle))
        elif not any(_begins(x, y) for x in missing for y in MERGED[name]):
            raise model.refusal(
                "forces",
                f"no ligament's name begins with {' or '.join(MERGED[name])}",
                "Import the bundles separately, or rename them.",
            )
    return lines


def bundle_names(
    name: str, ligaments: Sequence[Ligament], missing: Sequence[str] = ()
) -> list[Ligament]:
    """The bundles of one of the four single lines, of those of the model that are read."""
    for beginning in MERGED[name]:
        bundle = [x for x in ligaments if _begins(x.name, beginning)]
        # Deep bundles must not stand for superficial ones that are not read.
        if bundle or any(_begins(x, beginning) for x in missing):
            return bundle
    return []


def straightened(ligament: Ligament) -> Ligament:
    """The straight line between the insertions of a ligament, with its slack length."""
    if ligament.wrap is None:
        return ligament
    straight, slack = replace(ligament, wrap=None), slack_length(ligament) * MM_PER_M
    return replace(straight, reference_strain_pct=100.0 * (straight.length / slack - 1.0))


def _begins(name: str, beginning: str) -> bool:
    place = name.lower().find(beginning.lower())
    return place == 0 or (place > 0 and beginning in WHOLE)


def line_for(name: str, bundle: Sequence[Ligament]) -> Ligament:
    """One line for a bundle: mean ends, the sum of the stiffnesses, the strain they weight."""
    stiffness = np.array([x.stiffness_kN for x in bundle])
    strain = np.array([x.reference_strain_pct for x in bundle])
    total = float(stiffness.sum())
    return Ligament(
        name=name,
        femur=np.mean([x.femur for x in bundle], axis=0),
        tibia=np.mean([x.tibia for x in bundle], axis=0),
        stiffness_kN=total,
        reference_strain_pct=float(np.average(strain, weights=stiffness if total else None)),
    )


def slack_length(ligament: Ligament) -> float:
    """Slack length of a ligament [m].

    Examples
    --------
    >>> ends = {"femur": np.zeros(3), "tibia": np.array([0.0, -33.0, 0.0])}
    >>> line = Ligament(name="ACL", **ends, stiffness_kN=10.0, reference_strain_pct=10.0)
    >>> round(slack_length(line), 12)
    0.03
    """
    return ligament.length / MM_PER_M / (1.0 + ligament.reference_strain_pct / 100.0)


def _ligament(
    model: OsimModel, element: Element, ends: Mapping[str, Array], obstacle: Obstacle | None
) -> Ligament:
    name = element.get("name", "")
    slack = model.number(element, "slack_length")
    stiffness = model.number(element, "linear_stiffness")
    if slack <= 0.0:
        raise model.refusal(
            f"ligament {name}", f"its slack length is {slack:g} m", "Give a positive one."
        )
    length = float(np.linalg.norm(ends["tibia"] - ends["femur"]))
    if length < SHORTEST * slack:
        why = f"its slack length is {slack:g} m, and its ends are {length:.3g} m apart"
        raise model.refusal(f"ligament {name}", why, "Give the slack length in metres.")
    try:
        made = Ligament(
            name=name,
            femur=ends["femur"] * MM_PER_M,
            tibia=ends["tibia"] * MM_PER_M,
            stiffness_kN=stiffness / 1000.0,
            reference_strain_pct=0.0,
            wrap=obstacle,
        )
        strain = 100.0 * (made.length / MM_PER_M / slack - 1.0)
        return replace(made, reference_strain_pct=strain)
    except ValueError as error:
        raise InputError(
            model.path, f"ligament {name}", str(error), "Correct it in the model."
        ) from error


# Largest plausible surface of a knee [m].
LARGEST_M = 1.0
# Unconnected parts of a tibial mesh below this share of its area are left out as crumbs.
CRUMB_SHARE = 0.01


@declared
class ImportedKnee:
    """A knee of an OpenSim model, and what of the model is not in it."""

    knee: Knee = entry("The knee")
    bones: Bones = entry("Its joint and bodies in the model")
    not_taken: tuple[NotTaken, ...] = entry("What of its ligaments and meshes is not in it")


def import_opensim(
    path: PathLike,
    *,
    bundles: Literal["separate", "merged"] = "separate",
    side: Side | None = None,
    wrapping: bool = True,
) -> Knee:
    """The knee of an OpenSim 4 model, all joint coordinates being zero.

    The femur is the body named so that carries a contact mesh, the tibia likewise; one joint
    connects them, perhaps with welds in between. Its two frames become the frames of the bones, in
    mm. Every ``Blankevoort1991Ligament`` from one to the other becomes a line, its reference strain
    following from its slack length. A line wraps around the cylinder or sphere of its path, and
    around a cylinder in place of an ellipsoid; one that bends at points or wraps around several
    objects becomes straight. The description lists which were changed. One whose force is switched
    off is left out, and so are other classes; the command lists them. Contact meshes are looked for
    beside the file and in ``Geometry``, whatever the case of their names. A tibial mesh in one
    piece is cut between the plateaus.

    Parameters
    ----------
    path
        The ``.osim`` file, or the name ``"lenhart2015"`` for the one that comes with identknee.
    bundles
        ``"separate"`` for the ligaments as they are, those tied that are called alike but for a
        number at the end; ``"merged"`` for ACL, PCL, LCL and (superficial) MCL alone, each the
        mean of its bundles' insertions, the sum of their stiffnesses and the mean of their strains
        weighted by stiffness. A line whose bundles are all left out is left out, too.
    side
        ``"right"`` or ``"left"``, where the model has both knees.
    wrapping
        False for straight lines in place of all paths that wrap.

    Raises
    ------
    InputError
        If a file cannot be read, holds no such knee or more than one, or uses something that is not
        supported.

    References
    ----------
    .. [1] Blankevoort and Huiskes (1991), J. Biomech. Eng. 113(3), 263-269.
           https://doi.org/10.1115/1.2894883
    """
    return imported_knee(path, bundles=bundles, side=side, wrapping=wrapping).knee


def imported_knee(
    path: PathLike,
    *,
    bundles: Literal["separate", "merged"] = "separate",
    side: Side | None = None,
    wrapping: bool = True,
) -> ImportedKnee:
    """The knee as `import_opensim` gives it, with what of its ligaments and meshes is not in it.

    Raises
    ------
    InputError
        As `import_opensim` does.
    """
    if bundles not in ("separate", "merged"):
        raise ValueError(f'bundles must be "separate" or "merged", got {bundles!r}')
    if side not in ("right", "left", None):
        raise ValueError(f'side must be "right" or "left", got {side!r}')
    model = OsimModel(opensim_file(path))
    bones = bones_of(model, side)
    meshes = contact_meshes(model)
    lines, not_taken = lines_of(bones, wrapping=wrapping)
    ligaments = [x.ligament for x in lines]
    remarks = [f"{capitalised(x.why)}: {', '.join(x.names)}." for x in not_taken]
    if bundles == "merged":
        missing = unread_names(bones, not_taken)
        used = [y.name for x in MERGED for y in bundle_names(x, ligaments, missing)]
        rest = tuple(x.name for x in ligaments if x.name not in used)
        if rest:
            why = "it belongs to none of the four lines"
            beside = NotTaken(kind=LIGAMENT_CLASS, names=rest, change="left out", why=why)
            not_taken = [*not_taken, beside]
        bent = tuple(x.name for x in ligaments if x.name in used and x.wrap is not None)
        if bent:
            beside = NotTaken(
                kind=LIGAMENT_CLASS, names=bent, change="changed", why=MERGED_STRAIGHT
            )
            not_taken = [*not_taken, beside]
        ligaments = merged(model, [straightened(x) for x in ligaments], missing)
    _check_files(bones, meshes)
    femur, about_femur = _meshes(model, meshes, bones.femur)
    tibia, about_tibia = _meshes(model, meshes, bones.tibia)
    _check_axes(bones, [x.ligament for x in lines], femur, tibia)
    plateaus, about_plateaus = _plateaus(bones, femur, tibia)
    knee = Knee(
        name=model.path.stem,
        side=bones.side,
        description=" ".join([f"Imported from {model.path.name}.", *remarks]),
        femur=femur,
        tibia=plateaus,
        ligaments=tuple(ligaments),
        groups=groups_by_name(ligaments) if bundles == "separate" else (),
        femur_frame=Frame(origin=np.zeros(3), axes=np.eye(3)),
        tibia_frame=Frame(
            origin=bones.tibia_frame.translation * MM_PER_M, axes=bones.tibia_frame.rotation.T
        ),
        landmarks=_landmarks(bones),
    )
    if knee.side == "left":
        knee = knee.mirrored()
    for finding in fatal_geometry_findings(knee):
        raise InputError(model.path, finding.where, finding.sentence, finding.remedy)
    return ImportedKnee(
        knee=knee,
        bones=bones,
        not_taken=(*not_taken, *about_femur, *about_tibia, *about_plateaus),
    )


def _check_files(bones: Bones, meshes: Sequence[Element]) -> None:
    """Refuse one file for both bones."""
    model = bones.model
    owner: dict[Path, str] = {}
    for mesh in meshes:
        body, _ = model.placed(mesh.findtext("socket_frame", ""))
        for bone, bodies in (("femur", bones.femur), ("tibia", bones.tibia)):
            if body in bodies:
                file = mesh_file(model, mesh, file_of(mesh))
                if owner.setdefault(file, bone) != bone:
                    raise model.refusal(
                        f"contact mesh {mesh.get('name')}",
                        f"femur and tibia have the same mesh file, {file.name}",
                        "Give each bone its own file.",
                    )


def file_of(mesh: Element) -> str:
    """The name of its file that a mesh states; empty without one."""
    return (mesh.findtext("mesh_file") or mesh.findtext("filename") or "").strip()


def _meshes(
    model: OsimModel, meshes: Sequence[Element], bodies: dict[str, Transform]
) -> tuple[Surface, list[NotTaken]]:
    """The contact meshes of some bodies in the common frame [mm], and what was mended in them."""
    surfaces: list[Surface] = []
    remarks = []
    for mesh in meshes:
        body, frame = model.placed(mesh.findtext("socket_frame", ""))
        if body not in bodies:
            continue
        for tag in ("location", "orientation"):
            if model.vector(mesh, tag, "0 0 0").any():
                raise model.refusal(
                    f"contact mesh {mesh.get('name')}",
                    f"its {tag} is not zero",
                    "Move the mesh in its file instead.",
                )
        file = mesh_file(model, mesh, file_of(mesh))
        surface = read_surface(file)
        factors = model.vector(mesh, "scale_factors", "1 1 1")
        is_mirrored = bool(factors.prod() < 0.0)
        # A mirror turns triangles round, whose normals must stay outward.
        faces = surface.faces[:, ::-1] if is_mirrored else surface.faces
        scaled = Surface(vertices=surface.vertices * factors, faces=faces)
        placed = (bodies[body] @ frame).moved(scaled).scaled(MM_PER_M)
        if (across := float(np.ptp(placed.vertices, axis=0).max() / MM_PER_M)) > LARGEST_M:
            raise model.refusal(
                f"contact mesh {mesh.get('name')}",
                f"{file.name} is {across:.3g} m across with its scale_factors",
                "Lengths must be in metres: for a file in mm write scale_factors 0.001 each.",
            )
        if any(np.array_equal(placed.vertices, x.vertices) for x in surfaces):
            remarks.append(remark(mesh, "the same surface is given twice"))
            continue
        surfaces.append(placed)
        if is_mirrored:
            why = "its scale factors mirror it, and its triangles are turned so that they face out"
            remarks.append(remark(mesh, why, "changed"))
        if clauses := surface.repairs.clauses:
            why = f"{file.name} was mended: {'; '.join(clauses)}"
            remarks.append(remark(mesh, why, "changed"))
    return joined(*surfaces), remarks


def remark(
    element: Element, why: str, change: Change = "left out", *, is_line: bool = False
) -> NotTaken:
    """That one element of a model is left out or changed."""
    names = (element.get("name") or "without a name",)
    return NotTaken(kind=element.tag, names=names, change=change, why=why, is_line=is_line)


def mesh_file(model: OsimModel, mesh: Element, name: str) -> Path:
    """The file of a mesh, beside the model or in its folder ``Geometry``.

    A name from Windows has backslashes, and upper and lower case that do not count there.

    Raises
    ------
    InputError
        If it is in neither.
    """
    folder = model.path.parent
    parts = [x for x in name.replace("\\", "/").split("/") if x not in ("", ".")]
    for way in (parts, ["Geometry", *parts], ["Geometry", *parts[-1:]], parts[-1:]):
        if parts and (found := whatever_case(folder, way)) is not None:
            return found
    raise model.refusal(
        f"contact mesh {mesh.get('name')}",
        f"its file {name or '(no name)'} is neither beside the model nor in Geometry",
        "Copy the mesh there.",
    )


# Least cosine of the angle between an axis of a bone and the one that it should be.
LEAST_COSINE = 0.7
AXES = np.eye(3)
WANTED = "Turn the frames of the joint in the model: x anterior, y superior, z to the right."


def _check_axes(
    bones: Bones, ligaments: Sequence[Ligament], femur: Surface, tibia: Surface
) -> None:
    """Refuse a joint whose frame on the femur is not anterior, superior and to the right."""
    lateral = AXES[2] * (1.0 if bones.side == "right" else -1.0)
    joint = bones.joint
    flexion = _flexion_axis(bones)
    if flexion is not None and abs(flexion @ lateral) < LEAST_COSINE:
        raise bones.model.refusal(
            f"joint {joint.name}",
            f"its flexion axis is {_axis_word(flexion)} of its frame on {joint.parent}, and must "
            "be lateral, which is z",
            WANTED,
        )
    ends = {"MCL": _mean_end(ligaments, "MCL", "sMCL", "dMCL"), "LCL": _mean_end(ligaments, "LCL")}
    medial = tibia.centroid if ends["MCL"] is None else ends["MCL"]
    outer = tibia.centroid if ends["LCL"] is None else ends["LCL"]
    up = femur.centroid - tibia.centroid
    facing = tibia.areas @ tibia.normals / tibia.areas.sum()
    if np.linalg.norm(facing) > LEAST_COSINE:
        # The plateaus face up, wherever the middle of the femur's surface is.
        up = facing * np.sign(facing @ up)
    across = outer - medial
    is_known = any(x is not None for x in ends.values())
    if up @ AXES[1] < LEAST_COSINE * np.linalg.norm(up):
        found = f"up is {_axis_word(up)}, and must be +y"
    elif is_known and across @ lateral < LEAST_COSINE * np.linalg.norm(across[[0, 2]]):
        known = " to ".join(name for name, x in ends.items() if x is not None)
        found = (
            f"lateral, as {known} says, is {_axis_word(across)}, and must be "
            f"{_axis_word(lateral)} in a {bones.side} knee"
        )
    else:
        return
    raise bones.model.refusal(
        f"joint {joint.name}", f"in its frame on {joint.parent} {found}", WANTED
    )


def _axis_word(direction: Array) -> str:
    """The axis that is closest to a direction.

    Examples
    --------
    >>> _axis_word(np.array([0.1, -3.0, 0.2]))
    '-y'
    """
    k = int(np.argmax(np.abs(direction)))
    return f"{'-' if direction[k] < 0.0 else '+'}{'xyz'[k]}"


def _flexion_axis(bones: Bones) -> Array | None:
    """The axis about which the joint flexes, of length 1; None where the model has none."""
    turns = [
        x
        for x in bones.joint.element.iterfind("SpatialTransform/TransformAxis")
        if x.get("name", "").startswith("rotation") and (x.findtext("coordinates") or "").strip()
    ]
    called = [
        x
        for x in turns
        if re.search("flex|knee_angle|extension", (x.findtext("coordinates") or "").lower())
    ]
    for turn in (*called[:1], *turns[:1]):
        axis = bones.model.vector(turn, "axis")
        if (length := float(np.linalg.norm(axis))) > 0.0:
            return axis / length
    return None


def _mean_end(ligaments: Sequence[Ligament], *beginnings: str) -> Array | None:
    """Middle of the ligaments with one of these beginnings of names [mm]; None without one."""
    own = [x for x in ligaments if any(_begins(x.name, y) for y in beginnings)]
    return np.mean([(x.femur + x.tibia) / 2.0 for x in own], axis=0) if own else None


# A surface in one piece spans both plateaus if it is at least this share as wide as the femur.
LEAST_WIDTH = 0.6
# The plateaus are divided at the narrowest of SLICES between these shares of the surface's width.
# Each must have LEAST_SHARE of its area.
MIDDLE, LEAST_SHARE, SLICES = (0.35, 0.65), 0.2, 31


def _plateaus(
    bones: Bones, femur: Surface, tibia: Surface
) -> tuple[tuple[Surface, Surface], list[NotTaken]]:
    """The medial and the lateral part of a tibial surface, and what was done to get them."""
    found = _parts(tibia)
    parts = [x for x in found if x.areas.sum() > CRUMB_SHARE * tibia.areas.sum()]
    remarks, kind = [], "contact mesh of the tibia"
    if crumbs := len(found) - len(parts):
        why = f"each has less than {CRUMB_SHARE:.0%} of its area"
        names = tuple(f"piece {i + 1}" for i in range(crumbs))
        remarks.append(NotTaken(kind=kind, names=names, change="left out", why=why))
    to_right = bones.tibia_frame.rotation[:, 2]
    if len(parts) == 1:
        (whole,) = parts
        middle = _cut(bones, femur, whole, to_right)
        is_left = whole.vertices[whole.faces].mean(axis=1) @ to_right < middle
        parts = [_part(whole, is_left), _part(whole, ~is_left)]
        why = f"one piece, cut between the plateaus at z = {middle:.1f} mm of the common frame"
        remarks.append(NotTaken(kind=kind, names=("tibia",), change="changed", why=why))
    if len(parts) != 2:
        raise bones.model.refusal(
            "contact geometry",
            f"the tibial mesh has {len(parts)} unconnected parts, not a medial and a lateral one",
            "Cut the mesh between the plateaus and remove everything else.",
        )
    left, right = sorted(parts, key=lambda x: float(x.centroid @ to_right))
    return ((left, right) if bones.side == "right" else (right, left)), remarks


def _cut(bones: Bones, femur: Surface, tibia: Surface, to_right: Array) -> float:
    """Where between the plateaus a tibial surface in one piece is narrowest [mm]."""
    along = tibia.vertices[tibia.faces].mean(axis=1) @ to_right
    width, of_femur = np.ptp(tibia.vertices @ to_right), np.ptp(femur.vertices @ to_right)
    low, high = along.min() + np.array(MIDDLE) * np.ptp(along)
    edges = np.linspace(low, high, SLICES + 1)
    area = np.histogram(along, edges, weights=tibia.areas)[0]
    # Of slices that are equally narrow the one in the middle.
    middles = (edges[1:] + edges[:-1]) / 2.0
    narrow = middles[area <= area.min() + 1e-9 * tibia.areas.sum()]
    middle = float(narrow[np.argmin(np.abs(narrow - (low + high) / 2.0))])
    share = float(tibia.areas[along < middle].sum() / tibia.areas.sum())
    if tibia.is_closed:
        why = "the tibial mesh is one closed surface, with the bone's side as well"
    elif width < LEAST_WIDTH * of_femur:
        why = (
            f"the tibial mesh is one piece {width:.0f} mm wide beside a femur of {of_femur:.0f} mm:"
            " it has one plateau"
        )
    elif min(share, 1.0 - share) < LEAST_SHARE:
        why = "the tibial mesh is one piece, and no place between two plateaus is found in it"
    else:
        return middle
    raise bones.model.refusal(
        "contact geometry", why, "Give the articular sides of both plateaus, and nothing else."
    )


def _parts(surface: Surface) -> list[Surface]:
    """The unconnected parts of a surface, the largest first."""
    n, ends = len(surface.vertices), surface.edges
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    number, label = connected_components(graph, directed=False)
    of_face = label[surface.faces[:, 0]]
    parts = [_part(surface, of_face == x) for x in range(number) if (of_face == x).any()]
    return sorted(parts, key=lambda x: x.areas.sum(), reverse=True)


def _part(surface: Surface, chosen: BoolArray) -> Surface:
    """Some of the triangles of a surface with their vertices, in their order."""
    used, faces = np.unique(surface.faces[chosen], return_inverse=True)
    return Surface(vertices=surface.vertices[used], faces=faces.reshape(-1, 3))


def _landmarks(bones: Bones) -> tuple[Landmark, ...]:
    """The hip and the ankle centre where joints of these names are on the bones."""
    found = {}
    for joint in bones.model.joints:
        if "hip" in joint.name.lower() and joint.child in bones.femur:
            place = bones.femur[joint.child] @ joint.child_frame
            found["hip_centre"] = place.translation
        elif "ankle" in joint.name.lower() and joint.parent in bones.tibia:
            place = bones.tibia[joint.parent] @ joint.parent_frame
            found["ankle_centre"] = place.translation
    return tuple(Landmark(name=x, position=y * MM_PER_M) for x, y in found.items())


# Sets of a model that are not read, and why.
UNREAD = {
    "ConstraintSet": "constraints are not read: the knee moves freely in five coordinates",
    "ControllerSet": "there is no control",
    "ProbeSet": "results follow from the trials alone",
    "MarkerSet": "markers are not read",
}
CONTACT_NUMBERS = ("elastic_modulus", "poissons_ratio", "thickness")
LINEAR = ("LinearFunction", "Constant")


def left_out_of(found: ImportedKnee) -> tuple[NotTaken, ...]:
    """All that was left out of the model or changed, what the knee rests on first.

    Elements of one class that are left out for the same reason are one entry.
    """
    bones = found.bones
    remarks = [
        *found.not_taken,
        *_forces(bones),
        *_motion(bones),
        *_contact(bones),
        *_bodies(bones),
        *(remark(x, why) for group, why in UNREAD.items() for x in bones.model.listed(group)),
    ]
    return tuple(_joined(remarks))


def _joined(remarks: Iterable[NotTaken]) -> Iterator[NotTaken]:
    """Elements of one class that are left out or changed for the same reason, as one entry."""
    groups: dict[tuple[str, str, str], list[NotTaken]] = {}
    for x in remarks:
        groups.setdefault((x.kind, x.change, x.why), []).append(x)
    for own in groups.values():
        yield replace(own[0], names=tuple(name for x in own for name in x.names))


def _forces(bones: Bones) -> Iterator[NotTaken]:
    own = {x.get("name") for x in bones.joint.element.iterfind("coordinates/Coordinate")}
    lines = other_ligaments(bones)
    for x in bones.model.forces:
        if x.tag == LIGAMENT_CLASS and not x.get("name") and _joins_the_bones(bones, x):
            yield remark(x, "a ligament without a name is not read", is_line=True)
    for x in lines:
        yield remark(x, f"only lines of class {LIGAMENT_CLASS} are read", is_line=True)
    for x in bones.model.forces:
        if x in lines or (x.tag == LIGAMENT_CLASS and not x.get("name")):
            continue
        coordinate = (x.findtext("coordinate") or "").strip().split("/")[-1]
        ends = set(ends_of(bones, x))
        if x.tag == LIGAMENT_CLASS:
            if x.find(PATH_POINTS) is None:
                yield remark(x, "its path has no points", is_line=True)
            elif ends != {"femur", "tibia"}:
                yield remark(x, "it does not lead from the femur to the tibia of this knee")
            elif bones.model.number_or_zero(x, "damping_coefficient"):
                yield remark(x, "damping is left out: there is no time", "changed")
        elif "Contact" in x.tag or x.tag in ("ElasticFoundationForce", "HuntCrossleyForce"):
            yield remark(x, CONTACT_OFF if is_off(x) else CONTACT_LAW, "changed")
        elif is_muscle(x):
            yield remark(x, "no muscle pulls")
        elif coordinate in own:
            yield remark(x, "it acts on a coordinate of this knee, and its class is not read")
        elif ends or _bodies_of(bones, x):
            yield remark(x, "it acts on a bone of this knee, and its class is not read")
        else:
            yield remark(x, "it does not act on a bone of this knee")


def _bodies_of(bones: Bones, force: Element) -> set[str]:
    """The bodies of this knee that a force names, in its sockets and on its path.

    A socket may also refer to a contact geometry, which is on a body.
    """
    geometry = {
        x.get("name", ""): x.findtext("socket_frame") or "/ground"
        for x in bones.model.listed("ContactGeometrySet")
    }
    texts = [(x.text or "").strip() for x in force.iter() if BODY_TAGS.fullmatch(x.tag) and x.text]
    named = {bones.model.placed(geometry.get(x.split("/")[-1], x))[0] for x in texts if x}
    return named & {*bones.femur, *bones.tibia}


def _motion(bones: Bones) -> Iterator[NotTaken]:
    """What the joint states of the knee's motion that is not in it."""
    joint = bones.joint.element
    axes = joint.findall("SpatialTransform/TransformAxis")
    driven = [(x.findtext("coordinates") or "").split() for x in axes]
    units = {
        name: " m" if (x.get("name") or "").startswith("translation") else " rad"
        for x, own in zip(axes, driven, strict=True)
        for name in own
    }
    for x in joint.iterfind("coordinates/Coordinate"):
        default = bones.model.number_or_zero(x, "default_value")
        if default:
            said = f"{default:g}{units.get(x.get('name', ''), '')}"
            yield remark(x, f"it is taken as zero, not as its default {said}", "changed")
        if (x.findtext("locked") or "").strip() == "true":
            yield remark(x, "it is locked in the model, and free here", "changed")
    several = {name for own in driven for name in own if sum(name in x for x in driven) > 1}
    for x, own in zip(axes, driven, strict=True):
        functions = {y.tag for y in x if y.tag.endswith((*LINEAR, "Function", "Spline"))}
        is_coupled = own and (several & set(own) or not functions <= {*LINEAR})
        if is_coupled and x.get("name") != "rotation1":
            why = f"its motion with {own[0]} is left out: the knee moves freely in five coordinates"
            yield remark(x, why)


def _contact(bones: Bones) -> Iterator[NotTaken]:
    own = {*bones.femur, *bones.tibia}
    meshes = {id(x) for x in contact_meshes(bones.model)}
    for x in bones.model.listed("ContactGeometrySet"):
        body = bones.model.placed(x.findtext("socket_frame") or "/ground")[0]
        if body not in own:
            yield remark(x, "it is on another body")
        elif id(x) not in meshes:
            yield remark(x, f"only {' and '.join(MESH_CLASSES)} are read")
        elif any(x.find(f".//{y}") is not None for y in CONTACT_NUMBERS):
            yield remark(x, CONTACT_LAW, "changed")


def _bodies(bones: Bones) -> Iterator[NotTaken]:
    own, other = {*bones.femur, *bones.tibia}, "left" if bones.side == "right" else "right"
    wrapped = {
        x.findtext("wrap_object")
        for line in bones.model.all_of(LIGAMENT_CLASS)
        if len(ends_of(bones, line)) == len(BONES)
        for x in line.iterfind(".//PathWrapSet/objects/PathWrap")
    }
    for x in bones.model.listed("BodySet"):
        name = x.get("name", "")
        if name in own:
            for wrap in x.iterfind("WrapObjectSet/objects/*"):
                if wrap.get("name") not in wrapped:
                    yield remark(wrap, "no ligament of this knee wraps around it")
        else:
            of_leg = side_in(name) == other
            yield remark(x, "it is of the other leg" if of_leg else "it is not a bone of this knee")
    for x in bones.model.listed("JointSet"):
        if x is not bones.joint.element and x.tag != "WeldJoint":
            yield remark(x, "it is not the joint of this knee")
