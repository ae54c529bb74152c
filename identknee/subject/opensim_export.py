"""A knee written back into the OpenSim model that it came from, which otherwise stays as it is."""

import re
import shutil
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.mechanics.pose import angles_of
from identknee.runs.declare import Array
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, prepare_folder, write_atomically
from identknee.subject.examples import opensim_file
from identknee.subject.knee import Frame, Knee
from identknee.subject.ligament import Ligament
from identknee.subject.opensim import (
    MERGED,
    TRANSITION_STRAIN,
    Bones,
    OsimLine,
    bones_of,
    bundle_names,
    file_of,
    import_opensim,
    line_for,
    lines_of,
    mesh_file,
    slack_length,
    straightened,
    unread_names,
)
from identknee.subject.opensim_model import LIGAMENT_CLASS, MM_PER_M, Element, OsimModel
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
    surfaces = {"femur": (written.femur,), "tibia": written.tibia}
    stem, side = file_name(knee.name), knee.side[0]
    geometry = prepare_folder(folder / "Geometry")
    root = ET.Element("OpenSimDocument", Version="40000")
    said = f"{knee.name}, written by identknee. {knee.description}".strip()
    model = _added(root, "Model", stem, credits=said, length_units="meters", force_units="N")
    bodies = _objects(model, "BodySet")
    meshes = _objects(model, "ContactGeometrySet")
    for bone, names in SURFACES.items():
        frame, body = frames[bone], _added(bodies, "Body", f"{bone}_{side}", **BODY)
        wraps = ET.SubElement(ET.SubElement(body, "WrapObjectSet"), "objects")
        for ligament in written.ligaments:
            if ligament.wrap is not None and ligament.wrap.bone == bone:
                _wrap_object(wraps, ligament, frame)
        attached = ET.SubElement(body, "attached_geometry")
        for name, surface in zip(names, surfaces[bone], strict=True):
            local = surface.moved(frame.axes, -frame.axes @ frame.origin).scaled(1.0 / MM_PER_M)
            file = write_surface(local, geometry / f"{stem}_{name}.stl").name
            # To be seen on its body, and as contact geometry.
            _added(attached, "Mesh", name, socket_frame="..", mesh_file=file)
            _added(
                meshes,
                "ContactMesh",
                f"{name}_contact",
                socket_frame=f"/bodyset/{bone}_{side}",
                location="0 0 0",
                orientation="0 0 0",
                filename=f"Geometry/{file}",
            )
    joints = _objects(model, "JointSet")
    femur, tibia = (f"/bodyset/{bone}_{side}" for bone in SURFACES)
    sockets = {"socket_parent_frame": "/ground", "socket_child_frame": femur}
    _added(joints, "WeldJoint", f"ground_femur_{side}", **sockets)
    sockets = {"socket_parent_frame": femur, "socket_child_frame": tibia}
    joint = _added(joints, "CustomJoint", f"knee_{side}", **sockets)
    coordinates = ET.SubElement(joint, "coordinates")
    transform = ET.SubElement(joint, "SpatialTransform")
    for place, name, direction, offset in _axes(knee, frames):
        coordinate = f"knee_{name}_{side}"
        ET.SubElement(coordinates, "Coordinate", name=coordinate)
        axis = " ".join(map(str, direction))
        element = _added(transform, "TransformAxis", place, coordinates=coordinate, axis=axis)
        _added(element, "LinearFunction", "function", coefficients=f"1 {offset!r}")
    forces = _objects(model, "ForceSet")
    for ligament in written.ligaments:
        element = ET.SubElement(forces, LIGAMENT_CLASS, name=ligament.name)
        line = ET.SubElement(element, "GeometryPath", name="geometrypath")
        points = ET.SubElement(ET.SubElement(line, "PathPointSet"), "objects")
        for bone, frame in frames.items():
            _added(
                points,
                "PathPoint",
                f"{ligament.name}_{bone}",
                socket_parent_frame=f"/bodyset/{bone}_{side}",
                location=_numbers(frame.to_local(getattr(ligament, bone)) / MM_PER_M),
            )
        if ligament.wrap is not None:
            around, name = (
                ET.SubElement(ET.SubElement(line, "PathWrapSet"), "objects"),
                ligament.name,
            )
            _added(around, "PathWrap", f"{name}_wraps", wrap_object=f"{name}_wrap")
        _add_texts(
            element,
            linear_stiffness=repr(1000.0 * ligament.stiffness_kN),
            transition_strain=repr(TRANSITION_STRAIN),
            slack_length=repr(slack_length(ligament)),
        )
    ET.indent(root)
    path = folder / f"{stem}.osim"
    return write_atomically(path, ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _wrap_object(objects: Element, ligament: Ligament, frame: Frame) -> None:
    """Add the obstacle of a ligament to its body's wrap objects."""
    wrap = ligament.wrap
    if wrap is None:
        return
    kind, turns, quadrant = "WrapSphere", np.zeros(3), "all"
    if wrap.axis is not None:
        along = frame.axes @ wrap.axis / np.linalg.norm(wrap.axis)
        side = frame.axes @ (np.zeros(3) if wrap.side is None else wrap.side)
        side = side - (side @ along) * along
        if side.any():
            quadrant = "x"
        else:
            side = np.linalg.svd(along[None])[2][1]
        side /= np.linalg.norm(side)
        turn = np.column_stack([side, np.cross(along, side), along])
        with warnings.catch_warnings():
            # Where two of the three angles turn about one axis, one of them is as good as zero.
            warnings.simplefilter("ignore", UserWarning)
            turns = Rotation.from_matrix(turn).as_euler("XYZ")
        kind = "WrapCylinder"
    _added(
        objects,
        kind,
        f"{ligament.name}_wrap",
        xyz_body_rotation=_numbers(turns),
        translation=_numbers(frame.to_local(wrap.centre[None])[0] / MM_PER_M),
        quadrant=quadrant,
        radius=repr(wrap.radius_mm / MM_PER_M),
        **({} if wrap.axis is None else {"length": "1"}),
    )


def file_name(name: str, ending: str = "") -> str:
    """A valid file name and XML path.

    Examples
    --------
    >>> file_name("S 07/left", ".osim")
    'S_07_left.osim'
    """
    return (re.sub(r"[^\w.-]+", "_", name).strip("._") or "knee") + ending


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


def _objects(model: Element, kind: str) -> Element:
    return ET.SubElement(ET.SubElement(model, kind, name=kind.lower()), "objects")


def _added(parent: Element, tag: str, name: str, **texts: str) -> Element:
    """A new element of this name, with a child for each of the texts."""
    made = ET.SubElement(parent, tag, name=name)
    _add_texts(made, **texts)
    return made


def _add_texts(parent: Element, **texts: str) -> None:
    for tag, text in texts.items():
        ET.SubElement(parent, tag).text = text


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(x)) for x in values)


# Largest difference of ends that are the same [mm]; files round to more digits.
SAME_PLACE = 1e-3
# Largest distance of the centres of bones and frames from one scan [mm].
SAME_BONE = 0.1
# Largest relative difference of numbers that are the same.
SAME_NUMBER = 1e-12
# Largest difference of the components of axes from one scan.
SAME_AXES = 1e-4


def write_opensim(knee: Knee, folder: PathLike, *, source: PathLike | None = None) -> Path:
    """Path of the OpenSim 4 model that now holds the knee; its meshes lie in ``Geometry`` beside.

    With a source, stiffness, slack length and the ends of the knee's ligaments are written into a
    copy of it and all else stays, muscles and other joints included. Where the knee has the merged
    line of several bundles, their stiffnesses change by the same factor and their strains by the
    same amount, so that their merged line is the knee's. Without one the model has two bodies,
    their joint, the cartilage and the ligaments; importing it gives the knee in the axes of its
    femur.

    Parameters
    ----------
    knee
        The knee. Its effects and uncertainties have no place in such a model.
    folder
        Where to write, made if it is not there.
    source
        The ``.osim`` file that the knee was imported from, or ``"lenhart2015"``.

    Raises
    ------
    InputError
        If the source cannot be used, has other frames or lacks a ligament of the knee, or if the
        folder cannot be written to.
    """
    target = prepare_folder(folder)
    if source is None:
        return write_minimal_model(knee, target)
    model = OsimModel(opensim_file(source))
    bones = bones_of(model, knee.side)
    written = knee.mirrored() if knee.side == "left" else knee
    _check_same(knee, model)
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True, insert_pis=True))
    root = ET.parse(model.path, parser).getroot()
    copies = dict(
        zip(
            map(id, model.root.iter()),
            (x for x in root.iter() if not callable(x.tag)),
            strict=True,
        )
    )
    for line, changed in _changed(written, bones):
        element = copies[id(line.element)]
        _set(element, "linear_stiffness", 1000.0 * changed.stiffness_kN)
        _set(element, "slack_length", slack_length(changed))
        _set(element, "transition_strain", TRANSITION_STRAIN)
        for bone, end in line.ends.items():
            place: Array = getattr(changed, bone)
            if np.abs(place - getattr(line.ligament, bone)).max() > SAME_PLACE:
                _set(copies[id(end.element)], "location", *end.frame.inverse(place / MM_PER_M))
    # The meshes that the model names and that lie where it looks for them.
    for element in model.root.iter():
        name = file_of(element)
        with suppress(InputError):
            if name:
                found = mesh_file(model, element, name)
                copy = prepare_folder(target / "Geometry") / found.name
                if not (copy.exists() and copy.samefile(found)):
                    shutil.copyfile(found, copy)
    path = target / file_name(knee.name, ".osim")
    if path.exists() and path.samefile(model.path):
        raise InputError(path, "", "this is the source itself", "Give another folder with --out.")
    content = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    if b"\r\n" in model.path.read_bytes():
        content = content.replace(b"\n", b"\r\n")
    return write_atomically(path, content)


def _check_same(knee: Knee, model: OsimModel) -> None:
    """Refuse a knee whose bones are not those of the model: its ligaments would end elsewhere."""
    own = import_opensim(model.path, side=knee.side)
    pairs = [(knee.femur_frame, own.femur_frame), (knee.tibia_frame, own.tibia_frame)]
    turned = max(np.abs(x.axes - y.axes).max() for x, y in pairs)
    shifted = max(np.abs(x.origin - y.origin).max() for x, y in pairs)
    apart = np.linalg.norm(knee.femur.centroid - own.femur.centroid)
    if knee.side != own.side or turned > SAME_AXES or max(shifted, apart) > SAME_BONE:
        raise model.refusal(
            "",
            f"its femur and tibia are not those of {knee.name}",
            "Give the model that the knee was imported from, or none.",
        )


def _changed(knee: Knee, bones: Bones) -> Iterator[tuple[OsimLine, Ligament]]:
    """The model's lines that are ligaments of the knee, with their new values."""
    found, not_taken = lines_of(bones)
    lines = {x.ligament.name: x for x in found}
    missing = unread_names(bones, not_taken)
    # Merged lines are of straight ones; the slack lengths are the same.
    ligaments = [straightened(x.ligament) for x in lines.values()]
    for wanted in knee.ligaments:
        if wanted.name in lines:
            yield lines[wanted.name], wanted
            continue
        bundle = bundle_names(wanted.name, ligaments, missing) if wanted.name in MERGED else []
        if not bundle:
            raise bones.model.refusal(
                "forces",
                f"it has no ligament {wanted.name}",
                "Give the model that the knee was imported from, or none.",
            )
        # The bundles whose merged line is the one wanted.
        before = line_for(wanted.name, bundle)
        is_slack = before.stiffness_kN == 0.0
        factor = 0.0 if is_slack else wanted.stiffness_kN / before.stiffness_kN
        for x in bundle:
            yield (
                lines[x.name],
                Ligament(
                    name=x.name,
                    femur=x.femur + (wanted.femur - before.femur),
                    tibia=x.tibia + (wanted.tibia - before.tibia),
                    stiffness_kN=(
                        wanted.stiffness_kN / len(bundle) if is_slack else factor * x.stiffness_kN
                    ),
                    reference_strain_pct=x.reference_strain_pct
                    + wanted.reference_strain_pct
                    - before.reference_strain_pct,
                ),
            )


def _set(element: Element, tag: str, *values: float) -> None:
    """Put other numbers into a child; one that is left out, or says the same, stays as it is."""
    child = element.find(tag)
    if child is None:
        return
    before = [float(x) for x in (child.text or "").split()]
    if len(before) != len(values) or not np.allclose(before, values, rtol=SAME_NUMBER, atol=0.0):
        child.text = _numbers(values)
