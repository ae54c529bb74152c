"""Whether a subject is sound, and whether its trials are stable."""

from identknee.checks.subject_checks import StabilityReport, check_stability
from identknee.laxity.named_trials import TrialsLike, read_tests
from identknee.model.insertion_moves import WITHIN
from identknee.model.of_tests import model_of_tests
from identknee.runs.declare import declared, derived, entry
from identknee.runs.executors import threads
from identknee.runs.files import PathLike
from identknee.runs.findings import Severity
from identknee.runs.workers import Workers, executor_of
from identknee.subject.check import GeometryFinding, check_geometry
from identknee.verbs.subject_facts import SubjectFacts, facts_of
from identknee.verbs.verb import Run, SubjectLike, recorded_as, verb
from identknee.verbs.warming import warm_up

PROPOSAL = (
    "The subject does not state how well it is known, so it counts as exact. If you know nothing "
    "better, add to subject.toml: [uncertainty] insertions_mm = 2.0 (segmentation repeats to 1 to "
    "4 mm), contact_modulus = 0.3, contact_exponent = 0.2 and toe_region = 0.2 (estimates: no law "
    "of contact or of a toe region is exact)."
)


@declared
class SubjectCheck(SubjectFacts):
    """What is wrong with a subject, and how stable its trials are."""

    findings: tuple[GeometryFinding, ...] = entry("What was found, the gravest first", default=())
    stability: StabilityReport | None = entry(
        "How stable the trials are; null where an error forbids to simulate them",
        group="stability",
        default=None,
    )

    @property
    @derived("Findings that forbid any use", unit="1")
    def n_errors(self) -> int:
        """How many findings forbid any use."""
        return self._count(Severity.ERROR)

    @property
    @derived("Findings that should be looked at", unit="1")
    def n_warnings(self) -> int:
        """How many findings should be looked at."""
        return self._count(Severity.WARNING)

    def _count(self, severity: Severity) -> int:
        return sum(x.severity is severity for x in self.findings)


@verb
@recorded_as("subject check")
def check_subject(
    run: Run,
    subject: SubjectLike,
    *,
    protocol: TrialsLike = "seed63",
    samples: int = 200,
    within: float = WITHIN,
    out: PathLike | None = None,
    seed: int = 0,
    workers: Workers = 1,
) -> SubjectCheck:
    """Checks of surfaces, frames and ligaments, then of the stability of all trials.

    Stability is checked at the subject's own parameters and in a box around them: stiffness by
    +-50 %, reference strain by +-3 %. Where trials have no stable pose, each insertion is moved to
    see what that restores.

    Parameters
    ----------
    subject
        A knee, a subject folder, or the name of one that comes with identknee.
    protocol
        A protocol, the name of one, its TOML file, or a laxity table.
    samples
        Parameter vectors drawn from the box; 0 for none.
    within
        Uncertainty of the insertions [mm], up to 8.
    out
        Folder for the results; nothing is written if None.
    seed
        Seed of the draws.
    workers
        Threads to work with, or the address of a dask scheduler; results are the same.

    Raises
    ------
    InputError
        If subject or protocol cannot be read. What can be read but is wrong is a finding.
    """
    knee = run.knee
    tests = read_tests(protocol)
    findings, stability = check_geometry(knee), None
    if not any(x.severity is Severity.ERROR for x in findings):
        model = model_of_tests(knee, tests)
        warm_up(knee, model.protocol)
        run.start_clock()
        with executor_of(workers, threads) as executor:
            stability = check_stability(
                model, n_samples=samples, within_mm=within, seed=seed, executor=executor
            )
        findings += stability.findings
    return SubjectCheck(
        **facts_of(knee),
        findings=findings,
        stability=stability,
        assumptions=(PROPOSAL,) if knee.uncertainty.is_exact else (),
    )
