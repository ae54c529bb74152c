"""A knee as an OpenSim model of its own: two bodies, their joint, the cartilage, the ligaments."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from identknee.mechanics.pose import angles_of
from identknee.runs.arrays import Array
from identknee.runs.files import prepare_folder, write_atomically
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament
from identknee.subject.opensim_lines import LIGAMENT_CLASS, TRANSITION_STRAIN, slack_length
from identknee.subject.opensim_model import MM_PER_M, Element
from identknee.subject.surface import write_surface

# Transform axis, coordinate, direction and value in the scanned pose [rad, m].
Axis = tuple[str, str, Sequence[int], float]
BODY = {"mass": "1", "mass_center": "0 0 0", "inertia": "0.01 0.01 0.01 0 0 0"}
SURFACES = {"femur": ("femur",), "tibia": ("tibia_medial", "tibia_lateral")}


def write_minimal_model(knee: Knee, folder: Path) -> Path:
    """Path of the model: bodies in the bones' own frames, coordinates zero in the scanned pose.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    written = knee.mirrored() if knee.side == "left" else knee
    frames = {"femur": written.femur_frame, "tibia": written.tibia_frame}
    stem, side = file_name(knee.name), knee.side[0]
    _write_surfaces(written, frames, prepare_folder(folder / "Geometry"), stem)
    root = ET.Element("OpenSimDocument", Version="40000")
    model = ET.SubElement(root, "Model", name=stem)
    _text(model, "credits", f"{knee.name}, written by identknee. {knee.description}".strip())
    _text(model, "length_units", "meters")
    _text(model, "force_units", "N")
    bodies = _objects(model, "BodySet")
    meshes = _objects(model, "ContactGeometrySet")
    for bone, names in SURFACES.items():
        body = _body(bodies, f"{bone}_{side}")
        for name in names:
            _meshes(body, meshes, name, f"/bodyset/{bone}_{side}", f"{stem}_{name}.stl")
    joints = _objects(model, "JointSet")
    weld = ET.SubElement(joints, "WeldJoint", name=f"ground_femur_{side}")
    _sockets(weld, "/ground", f"/bodyset/femur_{side}")
    _knee_joint(joints, side, _axes(knee, frames))
    forces = _objects(model, "ForceSet")
    for ligament in written.ligaments:
        _ligament(forces, ligament, frames, side)
    ET.indent(root)
    path = folder / f"{stem}.osim"
    return write_atomically(path, ET.tostring(root, encoding="utf-8", xml_declaration=True))


def file_name(name: str, ending: str = "") -> str:
    """A name that a file and an XML path may have.

    Examples
    --------
    >>> file_name("S 07/left", ".osim")
    'S_07_left.osim'
    """
    return (re.sub(r"[^\w.-]+", "_", name).strip("._") or "knee") + ending


def _write_surfaces(written: Knee, frames: dict[str, Frame], folder: Path, stem: str) -> None:
    surfaces = {"femur": (written.femur,), "tibia": written.tibia}
    for bone, names in SURFACES.items():
        frame = frames[bone]
        for name, surface in zip(names, surfaces[bone], strict=True):
            local = surface.moved(frame.axes, -frame.axes @ frame.origin).scaled(1.0 / MM_PER_M)
            write_surface(local, folder / f"{stem}_{name}.stl")


def _axes(knee: Knee, frames: dict[str, Frame]) -> Iterator[Axis]:
    """The six axes of the knee, in the order in which they turn and shift the tibia."""
    femur, tibia = knee.femur_frame, knee.tibia_frame
    turns = angles_of(femur.axes @ tibia.axes.T)
    # Flexion, varus and internal rotation of both sides; a left knee is written as it was scanned.
    out = -1 if knee.side == "left" else 1
    names = ("flexion", "varus", "internal")
    axes = ((0, 0, -1), (out, 0, 0), (0, out, 0))
    for i, (name, axis, value) in enumerate(zip(names, axes, turns, strict=True), 1):
        yield f"rotation{i}", name, axis, float(value)
    shift = frames["femur"].to_local(frames["tibia"].origin) / MM_PER_M
    for i, (name, value) in enumerate(zip("xyz", shift, strict=True)):
        yield f"translation{i + 1}", name, [int(i == k) for k in range(3)], float(value)


def _knee_joint(joints: Element, side: str, axes: Iterator[Axis]) -> None:
    joint = ET.SubElement(joints, "CustomJoint", name=f"knee_{side}")
    _sockets(joint, f"/bodyset/femur_{side}", f"/bodyset/tibia_{side}")
    coordinates = ET.SubElement(joint, "coordinates")
    transform = ET.SubElement(joint, "SpatialTransform")
    for place, name, axis, value in axes:
        coordinate = f"knee_{name}_{side}"
        ET.SubElement(coordinates, "Coordinate", name=coordinate)
        element = ET.SubElement(transform, "TransformAxis", name=place)
        _text(element, "coordinates", coordinate)
        _text(element, "axis", " ".join(map(str, axis)))
        function = ET.SubElement(element, "LinearFunction", name="function")
        _text(function, "coefficients", f"1 {value!r}")


def _ligament(forces: Element, ligament: Ligament, frames: dict[str, Frame], side: str) -> None:
    element = ET.SubElement(forces, LIGAMENT_CLASS, name=ligament.name)
    path = ET.SubElement(element, "GeometryPath", name="geometrypath")
    points = ET.SubElement(ET.SubElement(path, "PathPointSet"), "objects")
    for bone, frame in frames.items():
        point = ET.SubElement(points, "PathPoint", name=f"{ligament.name}_{bone}")
        _text(point, "socket_parent_frame", f"/bodyset/{bone}_{side}")
        _text(point, "location", _numbers(frame.to_local(getattr(ligament, bone)) / MM_PER_M))
    _text(element, "linear_stiffness", repr(1000.0 * ligament.stiffness_kN))
    _text(element, "transition_strain", repr(TRANSITION_STRAIN))
    _text(element, "slack_length", repr(slack_length(ligament)))


def _body(bodies: Element, name: str) -> Element:
    body = ET.SubElement(bodies, "Body", name=name)
    for tag, value in BODY.items():
        _text(body, tag, value)
    return ET.SubElement(body, "attached_geometry")


def _meshes(attached: Element, meshes: Element, name: str, body: str, file: str) -> None:
    """The surface to be seen, on its body, and as contact geometry."""
    shown = ET.SubElement(attached, "Mesh", name=name)
    _text(shown, "socket_frame", "..")
    _text(shown, "mesh_file", file)
    mesh = ET.SubElement(meshes, "ContactMesh", name=f"{name}_contact")
    _text(mesh, "socket_frame", body)
    _text(mesh, "location", "0 0 0")
    _text(mesh, "orientation", "0 0 0")
    _text(mesh, "filename", f"Geometry/{file}")


def _sockets(joint: Element, parent: str, child: str) -> None:
    _text(joint, "socket_parent_frame", parent)
    _text(joint, "socket_child_frame", child)


def _objects(model: Element, kind: str) -> Element:
    return ET.SubElement(ET.SubElement(model, kind, name=kind.lower()), "objects")


def _text(parent: Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _numbers(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
