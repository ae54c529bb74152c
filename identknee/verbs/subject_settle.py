"""A subject whose insertions were moved until its trials converge."""

from dataclasses import replace
from typing import Unpack

from identknee.laxity.named_trials import read_tests
from identknee.model.insertion_moves import WITHIN, MovedInsertion, settle
from identknee.model.of_tests import model_of_tests
from identknee.runs.declare import declared, entry
from identknee.runs.executors import threads
from identknee.runs.workers import executor_of
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.options import OutOption, ProtocolName, Subject, Within, Workers
from identknee.verbs.subject_facts import LigamentFacts, facts_of
from identknee.verbs.verb import Run, recorded_as, verb
from identknee.verbs.warming import warm_up


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

    # typing.override came with Python 3.12.
    @property
    def failure(self) -> str:  # type: ignore[explicit-override]
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
    subject: Subject,
    *,
    protocol: ProtocolName = "seed63",
    within: Within = WITHIN,
    workers: Workers = 1,
    **_: Unpack[OutOption],
) -> SettledSubject:
    """The subject with its insertions moved, within their uncertainty, until all trials converge.

    They stay within their uncertainty. Writes a subject folder with the moved insertions, and says
    how far each one moved. A moved insertion is no longer the one that was segmented. The exit
    code is 1 if some trials still have no stable pose. Nothing is random.

    Raises
    ------
    ValueError
        If the distance is not between 0 and 8 mm.
    """
    model = model_of_tests(subject, read_tests(protocol))
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
        ligaments=facts_of(settled)["ligaments"],
        knee=settled,
    )
