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
from identknee.report.vtk_poses import write_poses
from identknee.runs.files import PathLike, write_atomically
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim_export import write_opensim
from identknee.verbs.fit import Calibration
from identknee.verbs.fitted_knee import as_fitted, as_stated, fitted_knee, fitted_values
from identknee.verbs.simulate import SimulatedLaxity
from identknee.verbs.subject_facts import SubjectFacts, exported_subject
from identknee.verbs.verb import SubjectLike

TABLE, POSES = "parameters.tsv", "vtk"
# What a parameter set is taken from, where there are several results.
SEARCHED = ("simulate", "profile", "fit")


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


def export_subject(
    subject: SubjectLike,
    *,
    fitted: PathLike | None = None,
    osim: bool = False,
    source: PathLike | None = None,
    vtk: bool = False,
    protocol: TrialsLike | None = None,
    out: PathLike,
) -> SubjectFacts:
    """What was written of a subject, as `export_knee` does, with the record of how it was made.

    Parameters
    ----------
    subject
        A knee, a subject folder, or the name of one that comes with identknee.
    fitted, osim, source, vtk, protocol, out
        As in `export_knee`.
    """
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
    searched = [x for x in results if x.verb in SEARCHED]
    return max(searched or results, key=_rank)


def _rank(result: Result) -> tuple[int, str]:
    verb = SEARCHED.index(result.verb) if result.verb in SEARCHED else -1
    return verb, str(result.record["started"])


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
    if protocol is None and isinstance(answer, SimulatedLaxity):
        protocol = answer.protocol
    tests = read_tests("drawer" if protocol is None else protocol)
    model = model_of_tests(knee, tests)
    if isinstance(answer, Calibration) and tests is answer.protocol:
        # The search of a measured trial begins at its measured pose.
        model = model.with_tests(answer.data)
    return write_poses(model, model.parameters.start, folder / POSES)
