"""What is said of a subject: what it is made of, and which insertions were moved."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from typing_extensions import override

from identknee.report.presenter import Presenter, Question, Statement, Table, table
from identknee.runs.words import listed_first
from identknee.subject.knee import Knee
from identknee.verbs.subject import ImportedSubject, SettledSubject, SubjectCheck, SubjectFacts

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Names of one class that a terminal shows.
MOST_NAMES = 4


def left_out_table(answer: ImportedSubject) -> Table:
    """What of a model was left out or changed."""
    return table(
        "Left out of the model, or changed (all names are in result.json)",
        ("class", ("how many", 0), "names", "", "why"),
        (
            (x.kind, len(x.names), listed_first(x.names, MOST_NAMES), x.change, x.why)
            for x in answer.left_out
        ),
    )


def subject_statements(answer: SubjectFacts) -> Iterator[Statement]:
    """Side and ligaments."""
    names = ", ".join(x.name for x in answer.ligaments)
    n = len(answer.ligaments)
    count = f"{n} ligament{'' if n == 1 else 's'}"
    sentence = f"{answer.subject}: {answer.side} knee, {count} ({names})."
    also = [f"Also written: {x}" for x in answer.written]
    yield Statement(question=Question.KNOWN, sentence="\n".join([sentence, *also]))


class SubjectPresenter(Presenter[SubjectFacts]):
    """How a subject is shown."""

    is_brief = True

    @override
    def statements(self, answer: SubjectFacts) -> Iterator[Statement]:
        yield from subject_statements(answer)

    @override
    def pictures(self, answer: SubjectFacts, knee: Knee) -> dict[str, "Figure"]:
        from identknee.report.scene import scene

        return {"scene": scene(knee)}


class ImportedSubjectPresenter(Presenter[ImportedSubject]):
    """How a subject made from a model is shown."""

    @override
    def statements(self, answer: ImportedSubject) -> Iterator[Statement]:
        """Side and ligaments, and what of the model is not in it."""
        yield from subject_statements(answer)
        if answer.left_out:
            lost = [x for x in answer.left_out if x.is_line and x.change == "left out"]
            lines = [f"{', '.join(x.names)} ({x.kind}): {x.why}." for x in lost]
            head = "Not all of the model is in the knee."
            sentence = "\n".join([head, *(f"Left out: {x}" for x in lines)])
            yield self.say(sentence, left_out_table(answer))


class SubjectCheckPresenter(Presenter[SubjectCheck]):
    """How the check of a subject is shown."""

    is_brief = True

    @override
    def statements(self, answer: SubjectCheck) -> Iterator[Statement]:
        """Side and ligaments, and whether stability was not checked."""
        yield from subject_statements(answer)
        if answer.stability is None:
            sentence = "Stability was not checked: correct the errors below first."
            yield Statement(question=Question.WRONG, sentence=sentence)


class SettledSubjectPresenter(Presenter[SettledSubject]):
    """How moved insertions are shown."""

    is_brief = True

    @override
    def statements(self, answer: SettledSubject) -> Iterator[Statement]:
        """How many trials converge, and which insertions moved."""
        sentence = (
            f"{answer.n_after} of {answer.n_trials} trials converge, {answer.n_before} before; the "
            f"lowest stability margin is {answer.lowest_margin:.3g} N/mm."
        )
        moved = [f"  {x.words}" for x in answer.moved] or ["No insertion was moved."]
        yield self.say("\n".join([sentence, *moved]))
