"""Knees of OpenSim models that describe contact and ligaments as OpenSim JAM does."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, check_readable
from identknee.runs.schema import shown
from identknee.subject.check import fatal_geometry_findings
from identknee.subject.examples import opensim_file
from identknee.subject.knee import Frame, Knee, Landmark, Ligament, Side, groups_by_name
from identknee.subject.surface import Surface, joined, read_surface

Element = ET.Element
MM_PER_M = 1000.0
# No length, angle, factor or stiffness of a knee comes near; products of larger ones may overflow.
LARGEST = 1e9
# Frames in frames, and functions of functions.
DEEPEST = 100
# These joints do not displace anything while their coordinates are zero.
ZERO_JOINTS = (
    "WeldJoint",
    "PinJoint",
    "SliderJoint",
    "BallJoint",
    "FreeJoint",
    "GimbalJoint",
    "PlanarJoint",
    "UniversalJoint",
)


@declared
class Transform:
    """Where a frame is in another: ``rotation @ point + translation``, lengths in m."""

    rotation: Array = entry("Rotation, shape ``(3, 3)``")
    translation: Array = entry("Translation [m], shape ``(3,)``")

    def __matmul__(self, other: "Transform") -> "Transform":
        return Transform(
            rotation=self.rotation @ other.rotation, translation=self(other.translation)
        )

    def __call__(self, points: Array) -> Array:
        """Points ``(..., 3)`` of this frame [m] in the outer one."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def moved(self, surface: Surface) -> Surface:
        """The surface of this frame [m] in the outer one."""
        return surface.moved(self.rotation, self.translation)

    @property
    def inverse(self) -> "Transform":
        """The inverse transform: the outer frame seen from this one."""
        turned = self.rotation.T
        return Transform(rotation=turned, translation=-turned @ self.translation)


IDENTITY = Transform(rotation=np.eye(3), translation=np.zeros(3))


@declared
class Joint:
    """A joint between two bodies."""

    name: str = entry("Name of the joint")
    kind: str = entry("Its class")
    parent: str = entry("Name of the parent body")
    child: str = entry("Name of the child body")
    parent_frame: Transform = entry("Where the joint's frame is in the parent body")
    child_frame: Transform = entry("Where it is in the child body")
    element: Element = entry("Its XML")


class OsimModel:
    """An OpenSim 4 model file.

    Attributes
    ----------
    path
        The file.
    root
        Its XML.
    joints
        All of its joints.
    """

    def __init__(self, path: PathLike) -> None:
        self.path: Path = check_readable(path)
        try:
            root = ET.parse(self.path).getroot()
        except (ET.ParseError, ValueError, LookupError) as error:
            raise InputError(
                self.path, "", f"this is not valid XML: {error}", "Save the model again."
            ) from error
        found = root.find("Model")
        if root.tag != "OpenSimDocument" or found is None:
            raise self.refusal("", "this is no OpenSim model", "Give the .osim file of a model.")
        if not root.get("Version", "").startswith("4"):
            raise self.refusal(
                "",
                f"the file is of version {root.get('Version', '?')}, not of OpenSim 4",
                "Open it in OpenSim 4 and save it again.",
            )
        units = (found.findtext("length_units") or "m").strip()
        if units not in ("m", "meters"):
            raise self.refusal(
                "length_units", f"lengths are in {units}", "Save the model in metres."
            )
        self.root: Element = root
        self._model = found
        self._offsets = {
            (joint.get("name", ""), frame.get("name", "")): frame
            for joint in found.iterfind("JointSet/objects/*")
            for frame in joint.iterfind("frames/PhysicalOffsetFrame")
        }
        self.joints = tuple(self._joint(x) for x in found.iterfind("JointSet/objects/*"))

    def all_of(self, kind: str) -> list[Element]:
        """All elements of a class that have a name, defaults excepted."""
        defaults = self._model.find("defaults")
        known = set() if defaults is None else {id(x) for x in defaults.iter(kind)}
        return [x for x in self._model.iter(kind) if x.get("name") and id(x) not in known]

    def refusal(self, where: str, why: str, remedy: str) -> InputError:
        """The error to raise about this file."""
        return InputError(self.path, where, why, remedy)

    def vector(self, element: Element, tag: str, default: str | None = None) -> Array:
        """The three numbers of a child element, shape ``(3,)``."""
        values = self.numbers(element, tag, default)
        if values.shape != (3,):
            raise self._malformed(element, tag, "three numbers")
        return values

    def number(self, element: Element, tag: str) -> float:
        """The one number of a child element."""
        values = self.numbers(element, tag)
        if values.shape != (1,):
            raise self._malformed(element, tag, "one number")
        return float(values[0])

    def numbers(self, element: Element, tag: str, default: str | None = None) -> Array:
        """The finite numbers of a child element."""
        text = element.findtext(tag, default)
        try:
            values = np.array([float(x) for x in (text or "").split()])
        except ValueError:
            raise self._malformed(element, tag, "numbers") from None
        if len(values) == 0 or not np.isfinite(values).all():
            raise self._malformed(element, tag, "finite numbers")
        if np.abs(values).max() > LARGEST:
            raise self._malformed(element, tag, f"numbers up to {LARGEST:g}")
        return values

    def placed(self, reference: str, joint: str = "", *, depth: int = 0) -> tuple[str, Transform]:
        """Body of a frame that a socket refers to, and where the frame is in that body.

        Parameters
        ----------
        reference
            A path such as ``/bodyset/femur_r``, or the name of a frame of the joint itself.
        joint
            The joint whose socket it is, where it is one's.
        depth
            In how many frames it is already.
        """
        if depth > DEEPEST:
            raise self.refusal(
                joint,
                f"frames lie in one another more than {DEEPEST} deep, or in a circle",
                "Open the model in OpenSim 4 and save it.",
            )
        parts = [x for x in reference.strip().split("/") if x not in ("", "..", ".")]
        if not parts:
            raise self.refusal(
                joint, "a frame is missing", "Open the model in OpenSim 4 and save it."
            )
        owner = parts[-2] if len(parts) > 1 else joint
        offset = self._offsets.get((owner, parts[-1]))
        if offset is None:
            return parts[-1], IDENTITY
        turns = self.vector(offset, "orientation", "0 0 0")
        inner = Transform(
            rotation=_about(0, turns[0]) @ _about(1, turns[1]) @ _about(2, turns[2]),
            translation=self.vector(offset, "translation", "0 0 0"),
        )
        parent = offset.findtext("socket_parent", "")
        body, outer = self.placed(parent, owner, depth=depth + 1)
        return body, outer @ inner

    def welded(self, body: str) -> dict[str, Transform]:
        """The bodies welded to `body`, itself included, each with where it is in `body`."""
        group = {body: IDENTITY}
        waiting = [body]
        welds = [x for x in self.joints if x.kind == "WeldJoint"]
        while waiting:
            here = waiting.pop()
            for weld in welds:
                across = weld.parent_frame @ weld.child_frame.inverse
                for near, far, step in (
                    (weld.parent, weld.child, across),
                    (weld.child, weld.parent, across.inverse),
                ):
                    if near == here and far not in group:
                        group[far] = group[here] @ step
                        waiting.append(far)
        return group

    def displacement(self, joint: Joint) -> Transform:
        """Where the joint's child frame is in its parent frame, all coordinates being zero."""
        if joint.kind in ZERO_JOINTS:
            return IDENTITY
        axes = {x.get("name"): x for x in joint.element.iterfind("SpatialTransform/TransformAxis")}
        if joint.kind != "CustomJoint":
            raise self.refusal(
                f"joint {joint.name}",
                f"joints of class {joint.kind} are not supported",
                "Replace it by a CustomJoint.",
            )
        if not axes:
            raise self.refusal(
                f"joint {joint.name}",
                "this CustomJoint has no SpatialTransform",
                "Give it one with its rotation and translation axes.",
            )
        rotation, translation = np.eye(3), np.zeros(3)
        for i in (1, 2, 3):
            turn, shift = axes.get(f"rotation{i}"), axes.get(f"translation{i}")
            if turn is not None:
                axis = self.vector(turn, "axis")
                if not axis.any():
                    raise self._malformed(turn, "axis", "a direction")
                rotation = rotation @ _turned(axis, self._at_zero(turn, joint.name))
            if shift is not None:
                translation = translation + self.vector(shift, "axis") * self._at_zero(
                    shift, joint.name
                )
        return Transform(rotation=rotation, translation=translation)

    def _joint(self, element: Element) -> Joint:
        name = element.get("name", "")
        parent, parent_frame = self.placed(element.findtext("socket_parent_frame", ""), name)
        child, child_frame = self.placed(element.findtext("socket_child_frame", ""), name)
        return Joint(
            name=name,
            kind=element.tag,
            parent=parent,
            child=child,
            parent_frame=parent_frame,
            child_frame=child_frame,
            element=element,
        )

    def _at_zero(self, element: Element, joint: str, *, depth: int = 0) -> float:
        """Value at zero of the function that an element holds."""
        function = next((x for x in element if x.get("name") == "function"), None)
        if function is None:
            nested = element.find("function")
            function = nested[0] if nested is not None and len(nested) else None
        if function is None:
            return 0.0
        if function.tag == "Constant":
            return self.number(function, "value")
        if function.tag in ("LinearFunction", "PolynomialFunction"):
            return float(self.numbers(function, "coefficients")[-1])
        if function.tag == "MultiplierFunction" and depth < DEEPEST:
            inner = self._at_zero(function, joint, depth=depth + 1)
            return self.number(function, "scale") * inner
        if function.tag in ("SimmSpline", "PiecewiseLinearFunction"):
            x, y = self.numbers(function, "x"), self.numbers(function, "y")
            # At a knot a spline has the knot's value, whatever its kind.
            if 0.0 in x and len(x) == len(y):
                return float(y[np.flatnonzero(x == 0.0)[0]])
        raise self.refusal(
            f"joint {joint}",
            f"its function {function.tag} cannot be evaluated at zero",
            "Use a constant, a linear function or a spline with a knot at zero.",
        )

    def _malformed(self, element: Element, tag: str, wanted: str) -> InputError:
        return self.refusal(
            f"{element.tag} {element.get('name', '')}".strip(),
            f"<{tag}> must hold {wanted}, got {shown(element.findtext(tag))}",
            "Open the model in OpenSim 4 and save it again.",
        )


def _about(axis: int, angle: float) -> Array:
    return _turned(np.eye(3)[axis], angle)


def _turned(axis: Array, angle: float) -> Array:
    """Rotation by `angle` [rad] about `axis` (3,), by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


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
    carriers = {model.placed(x.findtext("socket_frame", ""))[0] for x in contact_meshes(model)}
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
    is listed in the description. Contact meshes are looked for beside the file and in ``Geometry``.

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
