"""A knee written back into the OpenSim model that it came from, which otherwise stays as it is."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, prepare_folder, write_atomically
from identknee.subject.examples import opensim_file
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament
from identknee.subject.opensim import import_opensim, mesh_file
from identknee.subject.opensim_bones import Bones, bones_of
from identknee.subject.opensim_lines import (
    MERGED,
    TRANSITION_STRAIN,
    OsimLine,
    bundle_of,
    line_for,
    lines_of,
    slack_length,
)
from identknee.subject.opensim_minimal import file_name, write_minimal_model
from identknee.subject.opensim_model import MM_PER_M, Element, OsimModel

# Ends that differ by less [mm] are the same; files round further off.
SAME_PLACE = 1e-3
# Centres of bones and frames that are farther apart [mm] are not of one scan.
SAME_BONE = 0.1
# Numbers that differ by less, relatively, are the same.
SAME_NUMBER = 1e-12
# Axes that differ by more [-] are not of one scan.
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
    bones = bones_of(model)
    written = knee.mirrored() if knee.side == "left" else knee
    _check_same(knee, model)
    root = _with_comments(model)
    copies = dict(zip(map(id, model.root.iter()), _elements(root), strict=True))
    for line, changed in _changed(written, bones):
        _write_ligament(line, changed, copies)
    _copy_geometry(model, target / "Geometry")
    path = target / file_name(knee.name, ".osim")
    if path.exists() and path.samefile(model.path):
        raise InputError(path, "", "this is the source itself", "Give another folder with --out.")
    content = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    if b"\r\n" in model.path.read_bytes():
        content = content.replace(b"\n", b"\r\n")
    return write_atomically(path, content)


def _with_comments(model: OsimModel) -> Element:
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True, insert_pis=True))
    return ET.parse(model.path, parser).getroot()


def _elements(root: Element) -> Iterator[Element]:
    """All elements that are no comments."""
    return (x for x in root.iter() if not callable(x.tag))


def _check_same(knee: Knee, model: OsimModel) -> None:
    """Refuse a knee whose bones are not those of the model: its ligaments would end elsewhere."""
    own = import_opensim(model.path)
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
    """The model's lines that the knee speaks of, with what they are to be."""
    lines = {x.ligament.name: x for x in lines_of(bones)[0]}
    ligaments = [x.ligament for x in lines.values()]
    for wanted in knee.ligaments:
        if wanted.name in lines:
            yield lines[wanted.name], wanted
            continue
        bundle = bundle_of(wanted.name, ligaments) if wanted.name in MERGED else []
        if not bundle:
            raise bones.model.refusal(
                "forces",
                f"it has no ligament {wanted.name}",
                "Give the model that the knee was imported from, or none.",
            )
        for ligament in _shared(wanted, bundle):
            yield lines[ligament.name], ligament


def _shared(wanted: Ligament, bundle: Sequence[Ligament]) -> list[Ligament]:
    """The bundles whose merged line is the one wanted."""
    before = line_for(wanted.name, bundle)
    is_slack = before.stiffness_kN == 0.0
    factor = 0.0 if is_slack else wanted.stiffness_kN / before.stiffness_kN
    moved = {bone: getattr(wanted, bone) - getattr(before, bone) for bone in ("femur", "tibia")}
    return [
        Ligament(
            name=x.name,
            femur=x.femur + moved["femur"],
            tibia=x.tibia + moved["tibia"],
            stiffness_kN=(
                wanted.stiffness_kN / len(bundle) if is_slack else factor * x.stiffness_kN
            ),
            reference_strain_pct=x.reference_strain_pct
            + wanted.reference_strain_pct
            - before.reference_strain_pct,
        )
        for x in bundle
    ]


def _write_ligament(line: OsimLine, changed: Ligament, copies: dict[int, Element]) -> None:
    element = copies[id(line.element)]
    _set(element, "linear_stiffness", 1000.0 * changed.stiffness_kN)
    _set(element, "slack_length", slack_length(changed))
    _set(element, "transition_strain", TRANSITION_STRAIN)
    for bone, end in line.ends.items():
        place: Array = getattr(changed, bone)
        if np.abs(place - getattr(line.ligament, bone)).max() > SAME_PLACE:
            _set(copies[id(end.element)], "location", *end.frame.inverse(place / MM_PER_M))


def _set(element: Element, tag: str, *values: float) -> None:
    """Put other numbers into a child; one that is left out, or says the same, stays as it is."""
    child = element.find(tag)
    if child is None:
        return
    before = [float(x) for x in (child.text or "").split()]
    if len(before) != len(values) or not np.allclose(before, values, rtol=SAME_NUMBER, atol=0.0):
        child.text = " ".join(repr(float(x)) for x in values)


def _copy_geometry(model: OsimModel, folder: Path) -> None:
    """Copy the meshes that the model names and that lie where it looks for them."""
    for element in model.root.iter():
        name = (element.findtext("mesh_file") or element.findtext("filename") or "").strip()
        if not name:
            continue
        with suppress(InputError):
            found = mesh_file(model, element, name)
            copy = prepare_folder(folder) / found.name
            if not (copy.exists() and copy.samefile(found)):
                shutil.copyfile(found, copy)
