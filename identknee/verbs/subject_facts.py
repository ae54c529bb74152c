"""What a subject is made of, written as a subject folder where asked for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from identknee.laxity.named_trials import TrialsLike
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry
from identknee.runs.files import PathLike
from identknee.subject.examples import opensim_file
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim import import_opensim
from identknee.verbs.answer import Answer
from identknee.verbs.verb import Run, SubjectLike, recorded_as, verb


@declared
class LigamentFacts:
    """A ligament as the subject has it."""

    name: str = entry("Name of the ligament")
    femur_mm: Array = array("Femoral insertion in the scanned pose", "axis", unit="mm")
    tibia_mm: Array = array("Tibial insertion in the scanned pose", "axis", unit="mm")
    reference_length_mm: float = entry("Length in the scanned pose", unit="mm")
    stiffness_kN: float = entry("Stiffness per unit strain", unit="kN")  # noqa: N815 - the unit
    reference_strain_pct: float = entry("Strain in the scanned pose", unit="%")


@declared
class VertexCounts:
    """How finely the surfaces are drawn."""

    femur: int = entry("Vertices of the femoral surface", unit="1")
    tibia: tuple[int, ...] = entry("Vertices of the medial and the lateral tibial surface")


@declared
class SubjectFacts(Answer):
    """A subject's surfaces and ligaments."""

    subject: str = entry("Name of the subject")
    side: str = entry("right or left")
    n_vertices: VertexCounts = entry("Vertices of each surface")
    ligaments: tuple[LigamentFacts, ...] = entry("The ligaments", rows="ligament", group="subject")

    written: tuple[str, ...] = entry("Files written for other tools", default=())


def facts_of(knee: Knee) -> dict[str, Any]:
    """The fields of `SubjectFacts` by name."""
    return {
        "subject": knee.name,
        "side": knee.side,
        "n_vertices": VertexCounts(
            femur=len(knee.femur.vertices), tibia=tuple(len(x.vertices) for x in knee.tibia)
        ),
        "ligaments": tuple(
            LigamentFacts(
                name=x.name,
                femur_mm=x.femur,
                tibia_mm=x.tibia,
                reference_length_mm=x.length,
                stiffness_kN=x.stiffness_kN,
                reference_strain_pct=x.reference_strain_pct,
            )
            for x in knee.ligaments
        ),
    }


@verb
@recorded_as("subject show")
def describe_subject(
    run: Run, subject: SubjectLike, *, out: PathLike | None = None
) -> SubjectFacts:
    """What a subject is made of.

    Parameters
    ----------
    subject
        A knee, a subject folder, or the name of one that comes with identknee.
    out
        Folder for ``result.json`` and ``result.nc``; nothing is written if None.
    """
    return SubjectFacts(**facts_of(run.knee))


@verb
@recorded_as("subject export", secret=("written",))
def exported_subject(
    run: Run,
    subject: Knee,
    *,
    fitted: PathLike | None,
    osim: bool,
    source: PathLike | None,
    vtk: bool,
    protocol: TrialsLike | None,
    written: Sequence[PathLike],
    out: PathLike,
) -> SubjectFacts:
    """What a subject is made of that was written to `out`, and the files for other tools there."""
    return SubjectFacts(**facts_of(run.knee), written=tuple(map(str, written)))


def import_subject(
    file: PathLike,
    *,
    bundles: Literal["separate", "merged"] = "separate",
    out: PathLike | None = None,
) -> SubjectFacts:
    """The knee of an OpenSim model, written as a subject folder.

    Parameters
    ----------
    file
        An OpenSim/JAM model, or ``lenhart2015`` for the one that comes with identknee.
    bundles
        Keep the bundles separate, or merge them to four single lines.
    out
        The subject folder, which also gets the result; nothing is written if None.
    """
    knee = import_opensim(file, bundles=bundles)
    return _import(knee, osim=opensim_file(file), bundles=bundles, out=out)


@verb
@recorded_as("subject import-osim")
def _import(
    run: Run, subject: Knee, *, osim: Path, bundles: str, out: PathLike | None
) -> SubjectFacts:
    if run.out is not None:
        write_subject(run.knee, run.out)
    return SubjectFacts(**facts_of(run.knee))
