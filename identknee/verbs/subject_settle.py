"""A subject whose insertions were moved until its trials converge."""

from dataclasses import replace

from identknee.laxity.named_trials import TrialsLike, read_tests
from identknee.model.insertion_moves import WITHIN, MovedInsertion, settle
from identknee.model.of_tests import model_of_tests
from identknee.runs.declare import declared, entry
from identknee.runs.executors import threads
from identknee.runs.files import PathLike
from identknee.runs.workers import Workers, executor_of
from identknee.subject.folder import write_subject
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer
from identknee.verbs.subject_facts import LigamentFacts, facts_of
from identknee.verbs.verb import Run, SubjectLike, recorded_as, verb
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
    subject: SubjectLike,
    *,
    protocol: TrialsLike = "seed63",
    within: float = WITHIN,
    out: PathLike | None = None,
    workers: Workers = 1,
) -> SettledSubject:
    """The subject with its insertions moved, within their uncertainty, until all trials converge.

    A moved insertion is no longer the one that was segmented.

    Parameters
    ----------
    subject
        A knee, a subject folder, or the name of one that comes with identknee.
    protocol
        A protocol, the name of one, its TOML file, or a laxity table.
    within
        Uncertainty of the insertions [mm], up to 8.
    out
        The subject folder to write, which also gets the result; nothing is written if None.
    workers
        Threads to work with, or the address of a dask scheduler; results are the same.

    Raises
    ------
    ValueError
        If the distance is not between 0 and 8 mm.
    """
    model = model_of_tests(run.knee, read_tests(protocol))
    warm_up(run.knee, model.protocol)
    run.start_clock()
    with executor_of(workers, threads) as executor:
        found = settle(model, within_mm=within, executor=executor)
    settled = replace(found.knee, name=f"{run.knee.name}_settled")
    if run.out is not None:
        write_subject(settled, run.out)
    return SettledSubject(
        subject=run.knee.name,
        n_trials=found.n_trials,
        n_before=found.n_before,
        n_after=found.n_after,
        lowest_margin=found.lowest_margin,
        moved=found.moved,
        ligaments=facts_of(settled)["ligaments"],
        knee=settled,
    )
