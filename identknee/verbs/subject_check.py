"""Whether a subject is sound, and whether its trials are stable."""

from typing import Annotated, Unpack

from identknee.checks.subject_checks import StabilityReport, check_stability
from identknee.laxity.named_trials import read_tests
from identknee.model.insertion_moves import WITHIN
from identknee.model.of_tests import model_of_tests
from identknee.runs.declare import declared, derived, entry
from identknee.runs.executors import threads
from identknee.runs.findings import Severity
from identknee.runs.workers import executor_of
from identknee.subject.check import GeometryFinding, check_geometry
from identknee.verbs.options import OutOption, ProtocolName, Seed, Subject, Within, Workers, option
from identknee.verbs.subject_facts import SubjectFacts, facts_of
from identknee.verbs.verb import Run, recorded_as, verb
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

    @property
    def refuses_input(self) -> bool:  # type: ignore[explicit-override]
        """Whether a finding forbids any use."""
        return self.n_errors > 0

    def _count(self, severity: Severity) -> int:
        return sum(x.severity is severity for x in self.findings)


@verb
@recorded_as("subject check")
def check_subject(
    run: Run,
    subject: Subject,
    *,
    protocol: ProtocolName = "seed63",
    samples: Annotated[
        int, option("Number of parameter sets to draw from the ranges; 0 for none.", least=0)
    ] = 200,
    within: Within = WITHIN,
    seed: Seed = 0,
    workers: Workers = 1,
    **_: Unpack[OutOption],
) -> SubjectCheck:
    """What is wrong with a subject, and how stable its trials are.

    Checks surfaces, frames and ligaments, then the stability of the model under a protocol. It
    does so at the parameters of the subject and in a range around them: stiffness by +-50 %,
    reference strain by +-3 %. If trials have no stable pose, it says which insertions to move,
    within their uncertainty. The exit code is 2 if there is an error.

    Raises
    ------
    InputError
        If subject or protocol cannot be read. What can be read but is wrong is a finding.
    """
    tests = read_tests(protocol)
    findings, stability = check_geometry(subject), None
    if not any(x.severity is Severity.ERROR for x in findings):
        model = model_of_tests(subject, tests)
        warm_up(subject, model.protocol)
        run.start_clock()
        with executor_of(workers, threads) as executor:
            stability = check_stability(
                model, n_samples=samples, within_mm=within, seed=seed, executor=executor
            )
        findings += stability.findings
    return SubjectCheck(
        **facts_of(subject),
        findings=findings,
        stability=stability,
        assumptions=(PROPOSAL,) if subject.uncertainty.is_exact else (),
    )
