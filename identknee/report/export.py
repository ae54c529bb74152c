"""A knee, and what was found of it, in the files of other tools."""

from dataclasses import dataclass
from pathlib import Path

from identknee.laxity.named_trials import TrialsLike, read_tests
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.of_tests import model_of_tests
from identknee.report.overview.ranges import ranges_of
from identknee.report.page.results import Result, found_results
from identknee.report.parameter_table import parameter_table
from identknee.report.presenter import of_type, presenter_of
from identknee.report.vtk_poses import write_poses
from identknee.runs.files import PathLike, write_atomically
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim_export import write_opensim
from identknee.verbs.fit import Calibration
from identknee.verbs.fitted_knee import as_fitted, as_stated, fitted_knee, fitted_values
from identknee.verbs.options import GivenSubject, Out, documented
from identknee.verbs.registry import verb_named
from identknee.verbs.subject_facts import (
    ExportFitted,
    ExportOsim,
    ExportSource,
    ExportTrials,
    ExportVtk,
    SubjectFacts,
    exported_subject,
)

TABLE, POSES = "parameters.tsv", "vtk"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """What was written.

    Attributes
    ----------
    knee
        The knee as it was written.
    folder
        Its subject folder.
    others
        Files and folders for other tools.
    """

    knee: Knee
    folder: Path
    others: tuple[Path, ...]


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
        others.append(_write_table(knee, results, folder))
    if osim or source is not None:
        others.append(write_opensim(as_fitted(written), folder, source=source))
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

    With --fitted the knee has the parameters of a result, and parameters.tsv lists them in the
    form of PEtab with their 95 % sets. With --source they are written into a copy of the OpenSim
    model that the knee was imported from; the rest of that model is unchanged. With --osim alone
    the model holds two bones, their cartilage and the ligaments. With --vtk the knee is written
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
            as_stated(knee, result.answer)
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


def _write_table(knee: Knee, results: list[Result], folder: Path) -> Path:
    """The parameters, with what all results of the same data say of them."""
    latest = _latest(results)
    answer = latest.answer
    stated = as_stated(knee, answer)
    parameters = LaxityModel(knee=stated, protocol=load_protocol("drawer")).parameters
    settings = {} if answer.record is None else answer.record.settings
    table = parameter_table(
        parameters,
        fitted_values(answer),
        ranges_of([x.answer for x in results if x.data_digest == latest.data_digest]),
        fixed=settings.get("fixed") or (),
    )
    return write_atomically(folder / TABLE, table)


def _write_trials(
    knee: Knee, results: list[Result], protocol: TrialsLike | None, folder: Path
) -> Path:
    answer = _latest(results).answer if results else None
    if protocol is None and answer is not None:
        protocol = presenter_of(answer).protocol(answer)
    tests = read_tests("drawer" if protocol is None else protocol)
    model = model_of_tests(knee, tests)
    for fit in of_type([answer] if answer is not None else [], Calibration):
        if tests is fit.protocol:
            # The search of a measured trial begins at its measured pose.
            model = model.with_tests(fit.data)
    return write_poses(model, model.parameters.start, folder / POSES)
