"""A knee, and what was found of it, in the files of other tools."""

import base64
import csv
import io
import re
import zlib
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import TrialsLike, read_tests
from identknee.mechanics.closest_point import mesh_distance
from identknee.mechanics.distance_field import ContactLaw
from identknee.mechanics.ligament_tensions import ligament_tensions, line_courses, line_lengths
from identknee.mechanics.pose import place
from identknee.model.laxity_model import LaxityModel, model_for_tests
from identknee.model.parameters import Parameters
from identknee.report.overview import ranges_of
from identknee.report.presenter import Range, presenter_of, settings_of
from identknee.report.results import Result, found_results
from identknee.report.scene import distance_from_femur
from identknee.runs.declare import Array, IntArray
from identknee.runs.files import PathLike, prepare_folder, write_atomically
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim_export import file_name, write_opensim
from identknee.verbs.answer import Answer
from identknee.verbs.fit import Calibration
from identknee.verbs.fitted_knee import (
    fitted_knee,
    fitted_values,
    knee_as_fitted,
    with_stated_uncertainty_of,
)
from identknee.verbs.options import Out, Subject, option, trials_option
from identknee.verbs.registry import verb_named
from identknee.verbs.subject import SubjectFacts, subject_facts_of
from identknee.verbs.verb import Run, recorded_as, verb

TYPES: dict[str, np.dtype[Any]] = {
    "Float32": np.dtype("<f4"),
    "Int32": np.dtype("<i4"),
    "Int64": np.dtype("<i8"),
}


def polydata(
    points: Array,
    lines: Sequence[IntArray],
    triangles: IntArray,
    values: Mapping[str, ArrayLike],
    words: Mapping[str, Sequence[str]],
) -> bytes:
    """Content of a ``.vtp`` file.

    Parameters
    ----------
    points
        Shape ``(n, 3)``.
    lines, triangles
        Numbers of their points: one array for each of k lines, and shape ``(m, 3)``.
    values
        By name a number of each line, then of each triangle, ``(k + m,)``; NaN where it has none.
    words
        By name a list of words about the whole.
    """
    root = ET.Element(
        "VTKFile",
        type="PolyData",
        version="1.0",
        byte_order="LittleEndian",
        header_type="UInt32",
        compressor="vtkZLibDataCompressor",
    )
    whole = ET.SubElement(root, "PolyData")
    fields = ET.SubElement(whole, "FieldData")
    for name, texts in words.items():
        element = ET.SubElement(
            fields,
            "DataArray",
            type="String",
            Name=name,
            NumberOfTuples=str(len(texts)),
            format="ascii",
        )
        element.text = " ".join(str(x) for word in texts for x in (*word.encode("utf-8"), 0))
    counts = {"NumberOfPoints": len(points), "NumberOfLines": len(lines)}
    counts["NumberOfPolys"] = len(triangles)
    piece = ET.SubElement(whole, "Piece", {name: str(n) for name, n in counts.items()})
    _add(ET.SubElement(piece, "Points"), "Points", "Float32", points, NumberOfComponents="3")
    for kind, cells in (("Lines", lines), ("Polys", triangles)):
        held = ET.SubElement(piece, kind)
        _add(held, "connectivity", "Int64", np.concatenate([*cells, np.zeros(0, int)]))
        _add(held, "offsets", "Int64", np.cumsum([len(x) for x in cells]))
    cell_data = ET.SubElement(piece, "CellData")
    for name, given in values.items():
        own = np.asarray(given)
        _add(cell_data, name, "Int32" if own.dtype.kind == "i" else "Float32", own)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def collection(files: Sequence[str]) -> bytes:
    """Content of a ``.pvd`` file, which shows others one after the other."""
    root = ET.Element("VTKFile", type="Collection", version="1.0", byte_order="LittleEndian")
    listed = ET.SubElement(root, "Collection")
    for i, file in enumerate(files):
        ET.SubElement(listed, "DataSet", timestep=str(i), part="0", file=file)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _add(parent: ET.Element, name: str, kind: str, values: Array | IntArray, **more: str) -> None:
    """An array as one compressed block in base64, after how large it is before and after."""
    data = np.ascontiguousarray(values, TYPES[kind]).tobytes()
    block = zlib.compress(data)
    sizes = np.array([1, len(data), len(data), len(block)], "<u4").tobytes()
    element = ET.SubElement(
        parent, "DataArray", {"type": kind, "Name": name, "format": "binary", **more}
    )
    element.text = (base64.b64encode(sizes) + base64.b64encode(block)).decode("ascii")


COLLECTION = "trials.pvd"
BONES = ("femur", "medial tibia", "lateral tibia")


def write_poses(model: LaxityModel, theta: Array, folder: Path) -> Path:
    """Path of a collection with the knee in every trial that has a stable pose, one file each.

    The femur stays where it was scanned. Faces have ``gap_mm``, their distance from the other bone
    (negative where they overlap), and ``pressure_MPa`` by the contact law of the model. Lines have
    ``tension_N`` and ``strain_pct``. ``part`` counts the bones and then the lines; what it stands
    for is in the field ``parts``.

    Parameters
    ----------
    model
        Any laxity model.
    theta
        Its parameter vector, shape ``(p,)``.
    folder
        Where to write, made if it is not there.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    knee, setting = model.knee, model.setting(theta)
    prediction = model.predict(theta, derivatives=False)
    contact, field = model.surfaces(setting)
    law, lines = contact.law or ContactLaw(), setting.measured_lines
    flexion = setting.flexion[model.paths.trial_node]
    found = ligament_tensions(
        lines, flexion, prediction.poses, setting.stiffness, setting.reference_strain
    )
    slack = np.asarray(lines.reference_length) / (1.0 + setting.reference_strain)
    femur = setting.as_measured_points(knee.femur_frame.to_local(knee.femur.vertices), 0)
    tibia = [
        setting.as_measured_points(knee.tibia_frame.to_local(x.vertices), 1) for x in knee.tibia
    ]
    to_plateaus = [mesh_distance(own, x.faces) for own, x in zip(tibia, knee.tibia, strict=True)]
    surfaces, own_lines = (knee.femur, *knee.tibia), [x.name for x in knee.ligaments]
    # The scan of a left knee is seen in a mirror, which turns its triangles round.
    order = slice(None, None, -1 if knee.side == "left" else 1)
    target, names = prepare_folder(folder), []
    for i in np.flatnonzero(prediction.is_converged).tolist():
        placement = place(float(flexion[i]), prediction.poses[i])
        courses = line_courses(lines, placement)
        n, corners = len(courses), np.cumsum([0, *(len(x) for x in courses)])
        sheets = [femur, *(placement.to_femur(x) for x in tibia)]
        starts = np.cumsum([corners[-1], *(len(x) for x in sheets)])
        middles = [y[x.faces].mean(axis=1) for x, y in zip(surfaces, sheets, strict=True)]
        femoral = placement.to_tibia(middles[0])
        gaps = np.concatenate(
            [
                np.min([distance(femoral) for distance in to_plateaus], axis=0),
                *(distance_from_femur(field, x) for x in middles[1:]),
            ]
        )
        pressure = law.pressure(np.nan_to_num(-gaps, nan=-np.inf))[0]
        numbers = [np.full(len(x.faces), k) for k, x in enumerate(surfaces)]
        empty, none = np.full(n, np.nan), np.full(len(gaps), np.nan)
        strain = 100.0 * (line_lengths(lines, float(flexion[i]), prediction.poses[i]) / slack - 1.0)
        places = field.to_field(np.concatenate([*courses, *sheets]))
        content = polydata(
            knee.in_scan_frame(knee.femur_frame.to_common(places)),
            [np.arange(*x) for x in pairwise(corners.tolist())],
            np.concatenate(
                [x.faces[:, order] + k for x, k in zip(surfaces, starts[:-1], strict=True)]
            ),
            {
                "part": np.concatenate([len(BONES) + np.arange(n), *numbers]),
                "gap_mm": np.r_[empty, gaps],
                "pressure_MPa": np.r_[empty, pressure],
                "tension_N": np.r_[found.tensions[i], none],
                "strain_pct": np.r_[strain, none],
            },
            {
                "parts": [
                    *BONES,
                    *own_lines,
                    *(f"line {k + 1} of effects" for k in range(n - len(own_lines))),
                ],
                "trial": [model.protocol.trials[i]],
            },
        )
        name = file_name(f"{i + 1:03d}_{model.protocol.trials[i]}", ".vtp")
        write_atomically(target / name, content)
        names.append(name)
    return write_atomically(target / COLLECTION, collection(names))


COLUMNS = (
    *("parameterId", "parameterName", "parameterScale", "lowerBound", "upperBound"),
    *("nominalValue", "estimate", "objectivePriorType", "objectivePriorParameters"),
    *("fittedValue", "lower95", "upper95", "evidence"),
)


def parameter_table(
    parameters: Parameters,
    fitted: Mapping[str, float],
    ranges: Mapping[str, Sequence[Range]],
    *,
    fixed: Collection[str] = (),
) -> str:
    """The table as tab-separated text, a row a parameter.

    The first nine columns are those of PEtab. ``nominalValue`` is the subject's own value. The
    others are the value found and its 95 % set by the method named under ``evidence``; an open end
    and what is not known are blank. All scales are linear, since a stiffness may be zero; units end
    the names.
    """
    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    writer.writerow(COLUMNS)
    for i, name in enumerate(parameters.names):
        found = next(iter(ranges.get(name, ())), None)
        center, sd = float(parameters.center[i]), float(parameters.prior_sd[i])
        is_log = bool(parameters.is_log[i])
        prior = f"{np.log(center) if is_log else center};{sd}"
        numbers = (float(x[i]) for x in (parameters.lower, parameters.upper, parameters.start))
        row = [re.sub(r"\W", "_", name), name, "lin", *numbers, int(name not in fixed)]
        row += ["logNormal" if is_log else "normal", prior, fitted.get(name, "")]
        # The writer leaves None blank.
        row += [found.low, found.high, found.source.value] if found else [None] * 3
        writer.writerow(row)
    return text.getvalue()


TABLE, POSES = "parameters.tsv", "vtk"


@verb
@recorded_as("subject export")
def export_subject(
    _run: Run,
    subject: Subject,
    *,
    fitted: Annotated[
        PathLike | None,
        option(
            "A result of fit, profile or simulate for {SUBJECT}, whose parameters the knee gets, "
            "or a folder with several results.",
            in_python="The latest fit counts most.",
            metavar="DIR",
            typed=Path | None,
        ),
    ] = None,
    osim: Annotated[bool, option("Also write an OpenSim 4 model.")] = False,
    source: Annotated[
        PathLike | None,
        option(
            "The OpenSim model that {SUBJECT} was imported from: write a copy of it with the "
            "knee's ligaments. Give lenhart2015 for the one that comes with identknee.",
            metavar="FILE.osim",
            typed=str | None,
        ),
    ] = None,
    vtk: Annotated[
        bool, option("Also write the knee in every trial, for ParaView and PyVista.")
    ] = False,
    protocol: Annotated[
        TrialsLike | None,
        trials_option("The trials of {--vtk}: {}. If not given: those of the result, or drawer."),
    ] = None,
    out: Out,
) -> SubjectFacts:
    """What was written of a subject as a subject folder, and for other tools.

    With {--fitted} the knee has the parameters of a result, and parameters.tsv lists them in the
    form of PEtab with their 95 % sets. With {--source} they are written into a copy of the OpenSim
    model that the knee was imported from; the rest of that model is unchanged. With {--osim} alone
    the model holds two bones, their cartilage and the ligaments. With {--vtk} the knee is written
    in every trial, with gap and pressure on each face and the force of each ligament.

    Raises
    ------
    ValueError
        If a file cannot be used, or no result is one of this knee with a parameter set.
    """
    if out is None:
        raise ValueError("there is no folder to write to; give one with --out")
    results = [] if fitted is None else _of_knee(subject, fitted)
    latest = _latest(results) if fitted is not None else None
    knee = subject if latest is None else fitted_knee(subject, latest.answer)
    folder, others = write_subject(knee, out), list[Path]()
    if latest is not None:
        stated = with_stated_uncertainty_of(subject, latest.answer)
        table = parameter_table(
            LaxityModel(knee=stated, protocol=load_protocol("drawer")).parameters,
            fitted_values(latest.answer),
            ranges_of([x.answer for x in results if x.data_digest == latest.data_digest]),
            fixed=settings_of(latest.answer).get("fixed") or (),
        )
        others.append(write_atomically(folder / TABLE, table))
    if osim or source is not None:
        others.append(write_opensim(knee_as_fitted(knee), folder, source=source))
    if vtk:
        answer = None if latest is None else latest.answer
        others.append(_write_trials(knee, answer, protocol, folder))
    return SubjectFacts(**subject_facts_of(knee), written=tuple(map(str, others)))


def _of_knee(knee: Knee, folder: PathLike) -> list[Result]:
    """The results of this knee, older ones first within a verb."""
    results, refused = [], None
    for result in found_results(Path(folder)):
        try:
            with_stated_uncertainty_of(knee, result.answer)
        except ValueError as error:
            refused = error
        else:
            results.append(result)
    if refused is not None and not results:
        raise refused
    return results


def _latest(results: list[Result]) -> Result:
    """The result whose parameter set counts; without one the last is refused by who asks it."""

    def order(result: Result) -> tuple[int, str]:
        known = verb_named(result.verb)
        return 0 if known is None else known.parameter_rank, result.record.started

    return max(results, key=order)


def _write_trials(
    knee: Knee, answer: Answer | None, protocol: TrialsLike | None, folder: Path
) -> Path:
    if protocol is None and answer is not None:
        protocol = presenter_of(answer).protocol(answer)
    tests = read_tests("drawer" if protocol is None else protocol)
    model = model_for_tests(knee, tests)
    if isinstance(answer, Calibration) and tests is answer.protocol:
        # The search of a measured trial begins at its measured pose.
        model = model.with_tests(answer.data)
    return write_poses(model, model.parameters.start, folder / POSES)
