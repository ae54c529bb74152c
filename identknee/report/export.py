"""A knee, and what was found of it, in the files of other tools."""

import base64
import csv
import io
import re
import zlib
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import TrialsLike, read_tests
from identknee.mechanics.closest_point import mesh_distance
from identknee.mechanics.distance_field import ContactLaw
from identknee.mechanics.ligament_tensions import ligament_tensions, line_courses, line_lengths
from identknee.mechanics.pose import Placement, place
from identknee.model.laxity_model import LaxityModel, model_for_tests
from identknee.model.parameters import Parameters
from identknee.report.overview import ranges_of
from identknee.report.page.results import Result, found_results
from identknee.report.presenter import Range, of_type, presenter_of, settings_of
from identknee.report.scene import distance_from_femur
from identknee.runs.declare import Array, IntArray, declared, entry
from identknee.runs.files import PathLike, prepare_folder, write_atomically
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim_export import file_name, write_opensim
from identknee.verbs.fit import Calibration
from identknee.verbs.fitted_knee import (
    fitted_knee,
    fitted_values,
    knee_as_fitted,
    with_stated_uncertainty_of,
)
from identknee.verbs.options import GivenSubject, Out, documented
from identknee.verbs.registry import verb_named
from identknee.verbs.subject import (
    ExportFitted,
    ExportOsim,
    ExportSource,
    ExportTrials,
    ExportVtk,
    SubjectFacts,
    exported_subject,
)

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
    place = ET.SubElement(piece, "Points")
    _add(place, "Points", "Float32", points, NumberOfComponents="3")
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
    attributes = {"type": kind, "Name": name, "format": "binary", **more}
    element = ET.SubElement(parent, "DataArray", attributes)
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
    prediction = model.predict(theta, derivatives=False)
    poses = _Poses(model, theta, prediction.poses)
    target, names = prepare_folder(folder), []
    for i in np.flatnonzero(prediction.is_converged):
        name = file_name(f"{i + 1:03d}_{model.protocol.trials[i]}", ".vtp")
        write_atomically(target / name, poses.file(int(i)))
        names.append(name)
    return write_atomically(target / COLLECTION, collection(names))


class _Poses:
    """What all trials of a model share, and the file of each."""

    def __init__(self, model: LaxityModel, theta: Array, poses: Array) -> None:
        self._model, self._poses = model, poses
        knee, setting = model.knee, model.setting(theta)
        contact, self._field = model.surfaces(setting)
        self._law = contact.law or ContactLaw()
        self._flexion = setting.flexion[model.paths.trial_node]
        self._lines = setting.measured_lines
        femur = knee.femur_frame.to_local(knee.femur.vertices)
        self._femur = setting.as_measured_points(femur, 0)
        tibia = [knee.tibia_frame.to_local(x.vertices) for x in knee.tibia]
        self._tibia = [setting.as_measured_points(x, 1) for x in tibia]
        self._to_sheets = [
            mesh_distance(own, x.faces) for own, x in zip(self._tibia, knee.tibia, strict=True)
        ]
        self._stiffness, self._strain = setting.stiffness, setting.reference_strain

    def file(self, trial: int) -> bytes:
        """Content of the file of a trial."""
        knee = self._model.knee
        placement = place(float(self._flexion[trial]), self._poses[trial])
        lines = line_courses(self._lines, placement)
        n, corners = len(lines), np.cumsum([0, *(len(x) for x in lines)])
        sheets = [self._femur, *(placement.to_femur(x) for x in self._tibia)]
        starts = np.cumsum([corners[-1], *(len(x) for x in sheets)])
        surfaces = (knee.femur, *knee.tibia)
        # The scan of a left knee is seen in a mirror, which turns its triangles round.
        order = slice(None, None, -1 if knee.side == "left" else 1)
        triangles = [x.faces[:, order] + i for x, i in zip(surfaces, starts[:-1], strict=True)]
        gaps = np.concatenate(self._contact_gaps(placement))
        places = np.concatenate([*lines, *sheets])
        pressure = self._law.pressure(np.nan_to_num(-gaps, nan=-np.inf))[0]
        numbers = [np.full(len(x.faces), i) for i, x in enumerate(surfaces)]
        empty, none = np.full(n, np.nan), np.full(len(gaps), np.nan)
        pose, flexion = self._poses[trial : trial + 1], self._flexion[trial : trial + 1]
        found = ligament_tensions(self._lines, flexion, pose, self._stiffness, self._strain)
        length = line_lengths(self._lines, float(flexion[0]), pose[0])
        slack = np.asarray(self._lines.reference_length) / (1.0 + self._strain)
        tension, strain = found.tensions[0], 100.0 * (length / slack - 1.0)
        own = [x.name for x in self._model.knee.ligaments]
        return polydata(
            knee.in_scan_frame(knee.femur_frame.to_common(self._field.to_field(places))),
            [np.arange(*x) for x in pairwise(corners.tolist())],
            np.concatenate(triangles),
            {
                "part": np.concatenate([len(BONES) + np.arange(n), *numbers]),
                "gap_mm": np.r_[empty, gaps],
                "pressure_MPa": np.r_[empty, pressure],
                "tension_N": np.r_[tension, none],
                "strain_pct": np.r_[strain, none],
            },
            {
                "parts": [*BONES, *own, *(f"line {i + 1} of effects" for i in range(n - len(own)))],
                "trial": [self._model.protocol.trials[trial]],
            },
        )

    def _contact_gaps(self, placement: Placement) -> list[Array]:
        """Distance of the centre of each face from the other bone [mm], by bone."""
        knee = self._model.knee
        femoral = placement.to_tibia(self._femur[knee.femur.faces].mean(axis=1))
        to_tibia = np.min([distance(femoral) for distance in self._to_sheets], axis=0)
        tibial = [
            placement.to_femur(own[x.faces].mean(axis=1))
            for own, x in zip(self._tibia, knee.tibia, strict=True)
        ]
        return [to_tibia, *(distance_from_femur(self._field, x) for x in tibial)]


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
        row += ["logNormal" if is_log else "normal", prior, fitted.get(name, ""), *_set_of(found)]
        writer.writerow(row)
    return text.getvalue()


def _set_of(found: Range | None) -> tuple[float | str, float | str, str]:
    """Both ends of a set and the method that gave it."""
    if found is None:
        return "", "", ""
    low, high = ("" if x is None else float(x) for x in (found.low, found.high))
    return low, high, found.source.value


TABLE, POSES = "parameters.tsv", "vtk"


@declared
class Exported:
    """What was written."""

    knee: Knee = entry("The knee as it was written")
    folder: Path = entry("Its subject folder")
    others: tuple[Path, ...] = entry("Files and folders for other tools")


def export_knee(
    knee: Knee,
    out: PathLike,
    *,
    fitted: PathLike | None = None,
    osim: bool = False,
    source: PathLike | None = None,
    vtk: bool = False,
    protocol: TrialsLike | None = None,
) -> Exported:
    """The knee written as a subject folder, and for other tools.

    Parameters
    ----------
    knee
        The subject.
    out
        The folder, made if it is not there.
    fitted
        A result of `fit`, `profile` or `simulate` of the subject, or a folder with several: the
        knee is written with the parameters found, the latest fit counting most, and they become a
        table with the 95 % sets that these results have.
    osim
        Whether to write an OpenSim model as well.
    source
        The OpenSim model that the knee was imported from, of which a changed copy is written; it
        stands for `osim` too.
    vtk
        Whether to write the knee in every trial, for ParaView and PyVista.
    protocol
        The trials of `vtk`; those of the result, else of ``"drawer"``, if None.

    Raises
    ------
    ValueError
        If a file cannot be used, or no result is one of this knee with a parameter set.
    """
    results = [] if fitted is None else _of_knee(knee, fitted)
    written = knee if fitted is None else fitted_knee(knee, _latest(results).answer)
    folder = write_subject(written, out)
    others = []
    if results:
        latest = _latest(results)
        answer = latest.answer
        stated = with_stated_uncertainty_of(knee, answer)
        parameters = LaxityModel(knee=stated, protocol=load_protocol("drawer")).parameters
        settings = settings_of(answer)
        table = parameter_table(
            parameters,
            fitted_values(answer),
            ranges_of([x.answer for x in results if x.data_digest == latest.data_digest]),
            fixed=settings.get("fixed") or (),
        )
        others.append(write_atomically(folder / TABLE, table))
    if osim or source is not None:
        others.append(write_opensim(knee_as_fitted(written), folder, source=source))
    if vtk:
        others.append(_write_trials(written, results, protocol, folder))
    return Exported(knee=written, folder=folder, others=tuple(others))


@documented
def export_subject(
    subject: GivenSubject,
    *,
    fitted: ExportFitted = None,
    osim: ExportOsim = False,
    source: ExportSource = None,
    vtk: ExportVtk = False,
    protocol: ExportTrials = None,
    out: Out,
) -> SubjectFacts:
    """What was written of a subject as a subject folder, and for other tools.

    With {--fitted} the knee has the parameters of a result, and parameters.tsv lists them in the
    form of PEtab with their 95 % sets. With {--source} they are written into a copy of the OpenSim
    model that the knee was imported from; the rest of that model is unchanged. With {--osim} alone
    the model holds two bones, their cartilage and the ligaments. With {--vtk} the knee is written
    in every trial, with gap and pressure on each face and the force of each ligament.
    """
    if out is None:
        raise ValueError("there is no folder to write to; give one with --out")
    knee = subject if isinstance(subject, Knee) else read_subject(subject)
    made = export_knee(
        knee, out, fitted=fitted, osim=osim, source=source, vtk=vtk, protocol=protocol
    )
    return exported_subject(
        made.knee,
        fitted=fitted,
        osim=osim,
        source=source,
        vtk=vtk,
        protocol=protocol,
        written=made.others,
        out=out,
    )


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
    return max(results, key=lambda x: (_rank(x), str(x.record["started"])))


def _rank(result: Result) -> int:
    """How much the parameter set of the result counts."""
    verb = verb_named(result.verb)
    return 0 if verb is None else verb.parameter_rank


def _write_trials(
    knee: Knee, results: list[Result], protocol: TrialsLike | None, folder: Path
) -> Path:
    answer = _latest(results).answer if results else None
    if protocol is None and answer is not None:
        protocol = presenter_of(answer).protocol(answer)
    tests = read_tests("drawer" if protocol is None else protocol)
    model = model_for_tests(knee, tests)
    for fit in of_type([answer] if answer is not None else [], Calibration):
        if tests is fit.protocol:
            # The search of a measured trial begins at its measured pose.
            model = model.with_tests(fit.data)
    return write_poses(model, model.parameters.start, folder / POSES)
