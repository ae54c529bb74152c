"""Knees of OpenSim models that describe contact and ligaments as OpenSim JAM does."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike
from identknee.subject.check import fatal_geometry_findings
from identknee.subject.examples import opensim_file
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee, Landmark, Side
from identknee.subject.ligament import Ligament, groups_by_name
from identknee.subject.opensim_model import MM_PER_M, Element, Joint, OsimModel, Transform
from identknee.subject.surface import Surface, joined, read_surface

MESH_CLASSES = ("Smith2018ContactMesh", "ContactMesh")


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


def bones_of(model: OsimModel) -> Bones:
    """The joint of the model's only knee with contact meshes, and its bodies.

    Raises
    ------
    InputError
        If there is no such knee, or more than one.
    """
    carriers = {body_of(model, x) for x in contact_meshes(model)}
    femora = sorted(x for x in carriers if "femur" in x.lower())
    tibiae = sorted(x for x in carriers if "tibia" in x.lower())
    for bone, found in (("femur", femora), ("tibia", tibiae)):
        if len(found) != 1:
            raise model.refusal(
                "contact geometry",
                f"one {bone} with a contact mesh is wanted, found {', '.join(found) or 'none'}",
                f"Give a model of one knee whose {bone} is called so and has a contact mesh.",
            )
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
        side=_side(model, femora[0], joint.name, tibiae[0]),
        femur={name: to_parent @ place for name, place in femoral.items()},
        tibia={name: to_child @ place for name, place in tibial.items()},
        tibia_frame=tibia_frame,
    )


def _side(model: OsimModel, *names: str) -> Side:
    for name in names:
        found = re.search(r"(?:^|[_\-. ])(r|right|l|left)(?:[_\-. ]|$)", name.lower())
        if found:
            return "right" if found[1].startswith("r") else "left"
    raise model.refusal(
        "bodies",
        f"neither of {', '.join(names)} says which side it is of",
        "Let the name of the femur end with _r or _l.",
    )


def body_of(model: OsimModel, mesh: Element) -> str:
    """Body that a contact mesh is fixed to."""
    return model.placed(mesh.findtext("socket_frame", ""))[0]


LIGAMENT_CLASS = "Blankevoort1991Ligament"
TRANSITION_STRAIN = 0.06
# How the bundles of the four single lines begin; the first beginning that occurs is taken, so that
# the deep and posterior bundles of the medial collateral ligament stay out of its line.
MERGED = {"ACL": ("ACL",), "PCL": ("PCL",), "LCL": ("LCL",), "MCL": ("MCLs", "sMCL", "MCL")}


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


def lines_of(bones: Bones) -> tuple[list[OsimLine], list[str]]:
    """The ligaments between femur and tibia, and what to say about those not taken exactly.

    Raises
    ------
    InputError
        If there is none, or one cannot be used.
    """
    model = bones.model
    lines: list[OsimLine] = []
    bent, stiffening = [], []
    for element in model.all_of(LIGAMENT_CLASS):
        points = element.findall("GeometryPath/PathPointSet/objects/*")
        ends: dict[str, OsimEnd] = {}
        for point in (points[0], points[-1]) if len(points) > 1 else ():
            body, frame = model.placed(point.findtext("socket_parent_frame", ""))
            for bone, bodies in (("femur", bones.femur), ("tibia", bones.tibia)):
                if body in bodies:
                    ends[bone] = OsimEnd(element=point, frame=bodies[body] @ frame)
        if len(ends) < 2:
            continue
        name = element.get("name", "")
        places = {x: end.frame(model.vector(end.element, "location")) for x, end in ends.items()}
        ligament = _ligament(model, element, places)
        lines.append(OsimLine(ligament=ligament, element=element, ends=ends))
        wrap = element.find("GeometryPath/PathWrapSet/objects/PathWrap")
        if len(points) > 2 or wrap is not None:
            bent.append(name)
        if model.numbers(element, "transition_strain", "0.06")[0] != TRANSITION_STRAIN:
            stiffening.append(name)
    if not lines:
        raise model.refusal(
            "forces",
            f"no {LIGAMENT_CLASS} leads from the femur to the tibia",
            "Give a model whose ligaments are of that class.",
        )
    remarks = []
    if bent:
        remarks.append(f"Straight lines replace paths that wrap or bend: {', '.join(bent)}.")
    if stiffening:
        remarks.append(f"The transition strain 0.06 replaces that of {', '.join(stiffening)}.")
    return lines, remarks


def merged(model: OsimModel, ligaments: Sequence[Ligament]) -> list[Ligament]:
    """The four single lines, each from the bundles whose names begin with its own.

    Raises
    ------
    InputError
        If one of them has no bundle.
    """
    lines = []
    for name in MERGED:
        bundle = bundle_names(name, ligaments)
        if not bundle:
            raise model.refusal(
                "forces",
                f"no ligament's name begins with {' or '.join(MERGED[name])}",
                "Import the bundles separately, or rename them.",
            )
        lines.append(line_for(name, bundle))
    return lines


def bundle_names(name: str, ligaments: Sequence[Ligament]) -> list[Ligament]:
    """The bundles of one of the four single lines."""
    for beginning in MERGED[name]:
        bundle = [x for x in ligaments if x.name.lower().startswith(beginning.lower())]
        if bundle:
            return bundle
    return []


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


def _ligament(model: OsimModel, element: Element, ends: Mapping[str, Array]) -> Ligament:
    name = element.get("name", "")
    slack = model.number(element, "slack_length")
    if slack <= 0.0:
        raise model.refusal(
            f"ligament {name}", f"its slack length is {slack:g} m", "Give a positive one."
        )
    length = float(np.linalg.norm(ends["tibia"] - ends["femur"]))
    try:
        return Ligament(
            name=name,
            femur=ends["femur"] * MM_PER_M,
            tibia=ends["tibia"] * MM_PER_M,
            stiffness_kN=model.number(element, "linear_stiffness") / 1000.0,
            reference_strain_pct=100.0 * (length / slack - 1.0),
        )
    except ValueError as error:
        raise InputError(
            model.path, f"ligament {name}", str(error), "Correct it in the model."
        ) from error


# Parts of a tibial mesh smaller than this share of it are crumbs.
CRUMB_SHARE = 0.01


def import_opensim(path: PathLike, *, bundles: Literal["separate", "merged"] = "separate") -> Knee:
    """The knee of an OpenSim 4 model, all joint coordinates being zero.

    The femur is the body named so that carries a contact mesh, the tibia likewise; one joint
    connects them, perhaps with welds in between. Its two frames become the frames of the bones, in
    mm. Every ``Blankevoort1991Ligament`` from one to the other becomes a straight line, its
    reference strain following from its slack length; which of them wrapped or had further points
    is told in the description. Contact meshes are looked for beside the file and in ``Geometry``.

    Parameters
    ----------
    path
        The ``.osim`` file, or the name ``"lenhart2015"`` for the one that comes with identknee.
    bundles
        ``"separate"`` for the ligaments as they are, those tied that are called alike but for a
        number at the end; ``"merged"`` for ACL, PCL, LCL and (superficial) MCL alone, each the
        mean of its bundles' insertions, the sum of their stiffnesses and the mean of their strains
        weighted by stiffness.

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
    if bundles not in ("separate", "merged"):
        raise ValueError(f'bundles must be "separate" or "merged", got {bundles!r}')
    model = OsimModel(opensim_file(path))
    bones = bones_of(model)
    meshes = contact_meshes(model)
    lines, remarks = lines_of(bones)
    ligaments = [x.ligament for x in lines]
    if bundles == "merged":
        ligaments = merged(model, ligaments)
    knee = Knee(
        name=model.path.stem,
        side=bones.side,
        description=" ".join([f"Imported from {model.path.name}.", *remarks]),
        femur=joined(*_meshes(model, meshes, bones.femur)),
        tibia=_plateaus(bones, joined(*_meshes(model, meshes, bones.tibia))),
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
    return knee


def _meshes(
    model: OsimModel, meshes: Sequence[Element], bodies: dict[str, Transform]
) -> list[Surface]:
    """The contact meshes of some bodies in the common frame [mm]."""
    surfaces = []
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
        name = (mesh.findtext("mesh_file") or mesh.findtext("filename") or "").strip()
        surface = read_surface(mesh_file(model, mesh, name))
        factors = model.vector(mesh, "scale_factors", "1 1 1")
        scaled = Surface(vertices=surface.vertices * factors, faces=surface.faces)
        surfaces.append((bodies[body] @ frame).moved(scaled).scaled(MM_PER_M))
    return surfaces


def mesh_file(model: OsimModel, mesh: Element, name: str) -> Path:
    """The file of a mesh, beside the model or in its folder ``Geometry``.

    Raises
    ------
    InputError
        If it is in neither.
    """
    folder = model.path.parent
    for candidate in (folder / name, folder / "Geometry" / Path(name).name):
        if name and candidate.is_file():
            return candidate
    raise model.refusal(
        f"contact mesh {mesh.get('name')}",
        f"its file {name or '(no name)'} is neither beside the model nor in Geometry",
        "Copy the mesh there.",
    )


def _plateaus(bones: Bones, tibia: Surface) -> tuple[Surface, Surface]:
    """The medial and the lateral part of a tibial surface of two unconnected parts."""
    n, ends = len(tibia.vertices), tibia.edges
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    number, label = connected_components(graph, directed=False)
    parts = []
    for part in range(number):
        chosen = label == part
        faces = tibia.faces[chosen[tibia.faces[:, 0]]]
        if len(faces):
            renumbered = (np.cumsum(chosen) - 1)[faces]
            parts.append(Surface(vertices=tibia.vertices[chosen], faces=renumbered))
    parts = sorted(parts, key=lambda x: x.areas.sum(), reverse=True)
    parts = [x for x in parts if x.areas.sum() > CRUMB_SHARE * tibia.areas.sum()]
    if len(parts) != 2:
        raise bones.model.refusal(
            "contact geometry",
            f"the tibial mesh has {len(parts)} unconnected parts, not a medial and a lateral one",
            "Cut the mesh between the plateaus and remove everything else.",
        )
    to_right = bones.tibia_frame.rotation[:, 2]
    left, right = sorted(parts, key=lambda x: float(x.centroid @ to_right))
    return (left, right) if bones.side == "right" else (right, left)


def _landmarks(bones: Bones) -> tuple[Landmark, ...]:
    """The hip and the ankle centre where joints named so hold on to the bones."""
    found = {}
    for joint in bones.model.joints:
        if "hip" in joint.name.lower() and joint.child in bones.femur:
            place = bones.femur[joint.child] @ joint.child_frame
            found["hip_centre"] = place.translation
        elif "ankle" in joint.name.lower() and joint.parent in bones.tibia:
            place = bones.tibia[joint.parent] @ joint.parent_frame
            found["ankle_centre"] = place.translation
    return tuple(Landmark(name=x, position=y * MM_PER_M) for x, y in found.items())
