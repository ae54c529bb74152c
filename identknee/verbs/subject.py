"""Whether a subject is sound, and whether its trials are stable."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Unpack

from typing_extensions import override

from identknee.checks.subject_checks import StabilityReport, check_stability
from identknee.laxity.named_tables import TABLES
from identknee.laxity.table import example_laxity, read_tests
from identknee.model.insertion_moves import WITHIN, MovedInsertion, settle
from identknee.model.laxity_model import model_for_tests
from identknee.runs.declare import Array, array, declared, derived, entry
from identknee.runs.executors import executor_of, threads
from identknee.runs.files import PathLike
from identknee.runs.findings import Severity
from identknee.subject.check import GeometryFinding, check_geometry
from identknee.subject.examples import NAMED_SUBJECTS, opensim_file
from identknee.subject.folder import example, write_subject
from identknee.subject.knee import Knee, Side
from identknee.subject.opensim import NotTaken, imported_knee, left_out_of
from identknee.verbs import options
from identknee.verbs.answer import Answer
from identknee.verbs.options import argument, documented, option
from identknee.verbs.verb import Run, recorded_as, verb, warm_up

Bundles = Literal["separate", "merged"]


class ImportOptions(options.OutOption, total=False):
    """What an import was asked for, which the record of the call keeps."""

    osim: Annotated[Path, option("The model.")]
    bundles: Annotated[str, option("How bundles are kept.")]
    side: Annotated[str | None, option("Which knee, where it was asked for.")]


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


@declared
class ImportedSubject(SubjectFacts):
    """A subject made from a model, and what of the model is not in it."""

    left_out: tuple[NotTaken, ...] = entry(
        "What of the model was left out or changed, by class", default=()
    )


def subject_facts_of(knee: Knee) -> dict[str, Any]:
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
    _run: Run, subject: options.Subject, **_: Unpack[options.OutOption]
) -> SubjectFacts:
    """What a subject is made of."""
    return SubjectFacts(**subject_facts_of(subject))


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
    side: Annotated[Side | None, option("Which knee to take, where the model has both.")] = None,
    out: options.Out = None,
) -> ImportedSubject:
    """The knee of an OpenSim model, written as a subject folder.

    Lists what of the model was left out or changed.
    """
    found = imported_knee(file, bundles=bundles, side=side)
    return _import(
        found.knee,
        left_out=left_out_of(found),
        osim=opensim_file(file),
        bundles=bundles,
        side=side,
        out=out,
    )


@verb
@recorded_as("subject import-osim", secret=("left_out",))
def _import(
    run: Run,
    subject: options.Subject,
    *,
    left_out: Annotated[
        Sequence[NotTaken], option("What is not in the knee.", is_typed=False)
    ] = (),
    **_: Unpack[ImportOptions],
) -> ImportedSubject:
    if run.out is not None:
        write_subject(subject, run.out)
    return ImportedSubject(**subject_facts_of(subject), left_out=tuple(left_out))


PROPOSAL = (
    "The subject does not state how well it is known, so it is treated as exact. If you have no "
    "better information, add to subject.toml: [uncertainty] insertions_mm = 2.0 (segmentation "
    "repeats to 1 to 4 mm), contact_modulus = 0.3, contact_exponent = 0.2 and toe_region = 0.2 "
    "(estimates: no law of contact or of a toe region is exact)."
)


@declared
class SubjectCheck(SubjectFacts):
    """What is wrong with a subject, and how stable its trials are."""

    findings: tuple[GeometryFinding, ...] = entry(
        "What was found, the most severe first", default=()
    )
    stability: StabilityReport | None = entry(
        "How stable the trials are; null where an error forbids to simulate them",
        group="stability",
        default=None,
    )

    @property
    @derived("Findings that forbid any use", unit="1")
    def n_errors(self) -> int:
        return self._count(Severity.ERROR)

    @property
    @derived("Findings that should be looked at", unit="1")
    def n_warnings(self) -> int:
        return self._count(Severity.WARNING)

    def _count(self, severity: Severity) -> int:
        return sum(x.severity is severity for x in self.findings)


@verb
@recorded_as("subject check")
def check_subject(
    run: Run,
    subject: options.Subject,
    *,
    protocol: options.ProtocolName = "seed63",
    samples: Annotated[
        int, option("Number of parameter sets to draw from the ranges; 0 for none.", least=0)
    ] = 200,
    within: options.Within = WITHIN,
    seed: options.Seed = 0,
    workers: options.Workers = 1,
    **_: Unpack[options.OutOption],
) -> SubjectCheck:
    """What is wrong with a subject, and how stable its trials are.

    Checks surfaces, frames and ligaments, then the stability of the model under a protocol. It
    does so at the parameters of the subject and in a range around them: stiffness by +-50 %,
    reference strain by +-3 %. If trials have no stable pose, it says which insertions to move,
    within their uncertainty. The exit code is 1 if there is an error.

    Raises
    ------
    InputError
        If subject or protocol cannot be read. What can be read but is wrong is a finding.
    """
    tests = read_tests(protocol)
    findings, stability = check_geometry(subject), None
    if not any(x.severity is Severity.ERROR for x in findings):
        model = model_for_tests(subject, tests)
        warm_up(subject, model.protocol)
        run.start_clock()
        with executor_of(workers, threads) as executor:
            stability = check_stability(
                model, n_samples=samples, within_mm=within, seed=seed, executor=executor
            )
        findings += stability.findings
    return SubjectCheck(
        **subject_facts_of(subject),
        findings=findings,
        stability=stability,
        assumptions=(PROPOSAL,) if subject.uncertainty.is_exact else (),
    )


@declared
class SettledSubject(Answer):
    """A subject with insertions moved, and what that gained."""

    subject: str = entry("Name of the subject")
    n_trials: int = entry("Trials of the protocol", unit="1")
    n_before: int = entry(
        "Trials that converge with the insertions as given", unit="1", key="n_converged_before"
    )
    n_after: int = entry(
        "Trials that converge with the insertions moved", unit="1", key="n_converged_after"
    )
    lowest_margin: float = entry(
        "Lowest margin of the trials that converge then", unit="N/mm", key="lowest_margin_N_per_mm"
    )
    moved: tuple[MovedInsertion, ...] = entry("The insertions that moved")
    ligaments: tuple[LigamentFacts, ...] = entry(
        "The ligaments with the insertions moved", rows="ligament", group="subject"
    )
    knee: Knee | None = entry(
        "The subject with its insertions moved; None where the answer was read from files",
        is_in_json=False,
        default=None,
    )

    @property
    @override
    def failure(self) -> str:
        """Why the knee did not settle; empty where it did."""
        if self.n_after == self.n_trials:
            return ""
        return (
            f"{self.n_trials - self.n_after} of {self.n_trials} trials still do not converge; "
            "allow more with --within, up to 8 mm, or correct the ligament parameters"
        )


@verb
@recorded_as("subject settle")
def settle_subject(
    run: Run,
    subject: options.Subject,
    *,
    protocol: options.ProtocolName = "seed63",
    within: options.Within = WITHIN,
    workers: options.Workers = 1,
    **_: Unpack[options.OutOption],
) -> SettledSubject:
    """The subject with its insertions moved, within their uncertainty, until all trials converge.

    Writes a subject folder with the moved insertions, and says how far each one moved. A moved
    insertion is no longer the one that was segmented. The exit code is 1 if some trials still have
    no stable pose. Nothing is random.

    Raises
    ------
    ValueError
        If the distance is not between 0 and 8 mm.
    """
    model = model_for_tests(subject, read_tests(protocol))
    warm_up(subject, model.protocol)
    run.start_clock()
    with executor_of(workers, threads) as executor:
        found = settle(model, within_mm=within, executor=executor)
    settled = replace(found.knee, name=f"{subject.name}_settled")
    if run.out is not None:
        write_subject(settled, run.out)
    return SettledSubject(
        subject=subject.name,
        n_trials=found.n_trials,
        n_before=found.n_before,
        n_after=found.n_after,
        lowest_margin=found.lowest_margin,
        moved=found.moved,
        ligaments=subject_facts_of(settled)["ligaments"],
        knee=settled,
    )


@declared
class NamedSubjectFacts:
    """A knee that comes with identknee."""

    name: str = entry("Word that stands for the knee wherever a subject is wanted")
    side: str = entry("right or left")
    ligaments: tuple[str, ...] = entry("Names of the ligaments")
    source: str = entry("Where the knee comes from, as it is to be cited")
    licence: str = entry("Licence, as an SPDX expression")
    n_measured_trials: int = entry("Trials of measured laxity; 0 without", unit="1")
    has_opensim_model: bool = entry("Whether the OpenSim model of the knee is there too")
    description: str = entry("What the knee is")

    @property
    @derived("Whether the name also stands for a table of measured laxity")
    def has_measured_laxity(self) -> bool:
        return self.n_measured_trials > 0


@declared
class NamedSubjects:
    """The knees that come with identknee."""

    subjects: tuple[NamedSubjectFacts, ...] = entry("The knees")

    @override
    def __str__(self) -> str:
        """Each knee with its ligaments and its source."""
        lines = []
        for x in self.subjects:
            n = x.n_measured_trials
            laxity = f"{n} measured trials" if n else "no measured laxity"
            lines += [
                f"{x.name}: {x.side} knee, {laxity}, licence {x.licence}",
                f"  {len(x.ligaments)} ligaments: {', '.join(x.ligaments)}",
                f"  {x.source}",
            ]
        return "\n".join(lines)


def list_subjects() -> NamedSubjects:
    """The knees that come with identknee, with their sources and licences."""
    found = []
    for subject in NAMED_SUBJECTS:
        knee = example(subject.name)
        found.append(
            NamedSubjectFacts(
                name=subject.name,
                side=knee.side,
                ligaments=tuple(x.name for x in knee.ligaments),
                source=subject.source,
                licence=subject.licence,
                n_measured_trials=example_laxity(subject.name).n if subject.name in TABLES else 0,
                has_opensim_model=subject.opensim is not None,
                description=knee.description,
            )
        )
    return NamedSubjects(subjects=tuple(found))
