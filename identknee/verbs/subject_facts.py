"""What a subject is made of, written as a subject folder where asked for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Unpack

from identknee.laxity.named_trials import TrialsLike
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry
from identknee.runs.files import PathLike
from identknee.subject.examples import opensim_file
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim import import_opensim
from identknee.verbs.answer import Answer
from identknee.verbs.options import (
    Out,
    OutOption,
    Subject,
    argument,
    documented,
    option,
    trials_option,
)
from identknee.verbs.verb import Run, recorded_as, verb

Bundles = Literal["separate", "merged"]
ExportFitted = Annotated[
    PathLike | None,
    option(
        "A result of fit, profile or simulate for SUBJECT, whose parameters the knee gets, or a "
        "folder with several results.",
        in_python="The latest fit counts most.",
        metavar="DIR",
        typed=Path | None,
    ),
]
ExportOsim = Annotated[bool, option("Also write an OpenSim 4 model.")]
ExportSource = Annotated[
    PathLike | None,
    option(
        "The OpenSim model that SUBJECT was imported from: write a copy of it with the knee's "
        "ligaments. Give lenhart2015 for the one that comes with identknee.",
        metavar="FILE.osim",
        typed=str | None,
    ),
]
ExportVtk = Annotated[bool, option("Also write the knee in every trial, for ParaView and PyVista.")]
ExportTrials = Annotated[
    TrialsLike | None,
    trials_option("The trials of --vtk: {}. If not given: those of the result, or drawer."),
]


class ExportOptions(OutOption, total=False):
    """What an export was asked for, which the record of the call keeps."""

    fitted: ExportFitted
    osim: ExportOsim
    source: ExportSource
    vtk: ExportVtk
    protocol: ExportTrials


class ImportOptions(OutOption, total=False):
    """What an import was asked for, which the record of the call keeps."""

    osim: Annotated[Path, option("The model.")]
    bundles: Annotated[str, option("How bundles are kept.")]


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
def describe_subject(_run: Run, subject: Subject, **_: Unpack[OutOption]) -> SubjectFacts:
    """What a subject is made of."""
    return SubjectFacts(**facts_of(subject))


@verb
@recorded_as("subject export", secret=("written",))
def exported_subject(
    _run: Run,
    subject: Subject,
    *,
    written: Annotated[Sequence[PathLike], option("Files for other tools.", is_typed=False)] = (),
    **_: Unpack[ExportOptions],
) -> SubjectFacts:
    """What a subject is made of that was written to a folder, and the files for other tools."""
    return SubjectFacts(**facts_of(subject), written=tuple(map(str, written)))


@documented
def import_subject(
    file: Annotated[
        PathLike,
        argument(
            "An OpenSim/JAM model, or lenhart2015 for the one that comes with identknee.",
            "FILE.osim",
            typed=str,
        ),
    ],
    *,
    bundles: Annotated[
        Bundles, option("Keep the bundles separate, or merge them to four single lines.")
    ] = "separate",
    out: Out = None,
) -> SubjectFacts:
    """The knee of an OpenSim model, written as a subject folder."""
    knee = import_opensim(file, bundles=bundles)
    return _import(knee, osim=opensim_file(file), bundles=bundles, out=out)


@verb
@recorded_as("subject import-osim")
def _import(run: Run, subject: Subject, **_: Unpack[ImportOptions]) -> SubjectFacts:
    if run.out is not None:
        write_subject(subject, run.out)
    return SubjectFacts(**facts_of(subject))
