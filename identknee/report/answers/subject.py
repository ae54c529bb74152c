"""What is said of a subject: what it is made of, and which insertions were moved."""

from collections.abc import Iterator

from identknee.report.statement import Question, Statement
from identknee.verbs.subject_check import SubjectCheck
from identknee.verbs.subject_facts import SubjectFacts
from identknee.verbs.subject_settle import SettledSubject


def subject_statements(answer: SubjectFacts) -> Iterator[Statement]:
    """Side and ligaments."""
    names = ", ".join(x.name for x in answer.ligaments)
    n = len(answer.ligaments)
    count = f"{n} ligament{'' if n == 1 else 's'}"
    sentence = f"{answer.subject}: {answer.side} knee, {count} ({names})."
    also = [f"Also written: {x}" for x in answer.written]
    yield Statement(question=Question.KNOWN, sentence="\n".join([sentence, *also]))


def check_statements(answer: SubjectCheck) -> Iterator[Statement]:
    """Side and ligaments, and whether stability was not checked."""
    yield from subject_statements(answer)
    if answer.stability is None:
        sentence = "Stability was not checked: correct the errors below first."
        yield Statement(question=Question.WRONG, sentence=sentence)


def settle_statements(answer: SettledSubject) -> Iterator[Statement]:
    """How many trials converge, and which insertions moved."""
    sentence = (
        f"{answer.n_after} of {answer.n_trials} trials converge, {answer.n_before} before; the "
        f"lowest stability margin is {answer.lowest_margin:.3g} N/mm."
    )
    moved = [f"  {x.words}" for x in answer.moved] or ["No insertion was moved."]
    yield Statement(question=Question.KNOWN, sentence="\n".join([sentence, *moved]))
