"""Statements of an answer, the questions of the page they answer, and what the answer assumes."""

from enum import Enum, unique

from identknee.report.tables import Table
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding
from identknee.runs.words import listed
from identknee.verbs.answer import Answer

# So many trials are listed by name.
MOST_NAMED = 8


def assumption_sentences(answer: Answer) -> tuple[str, ...]:
    """The assumptions of an answer, as sentences."""
    trials = answer.trials_used
    if not trials:
        return answer.assumptions
    names = f": {listed(trials)}" if len(trials) <= MOST_NAMED else ""
    many = "1 measured trial" if len(trials) == 1 else f"{len(trials)} measured trials"
    return (f"The result rests on {many}{names}.", *answer.assumptions)


@unique
class Question(Enum):
    """What a reader asks, in the order of the page; the value is its place on the page."""

    KNOWN = "known"
    WRONG = "wrong"
    NEXT = "next"
    LAXITY = "laxity"
    SEARCH = "search"

    @property
    def heading(self) -> str:
        """How the page puts it."""
        return _HEADINGS[self]


_HEADINGS = {
    Question.KNOWN: "What is known, and what is not",
    Question.WRONG: "What the model gets wrong, and why",
    Question.NEXT: "Which test to do next",
    Question.LAXITY: "Measured and simulated laxity",
    Question.SEARCH: "How the parameters were searched for",
}


@declared
class Statement:
    """A sentence with its tables and figures."""

    question: Question = entry("What it answers")
    sentence: str = entry("One or a few whole sentences")
    tables: tuple[Table, ...] = entry("The numbers behind it", default=())
    is_answer: bool = entry("Whether it leads its part of the page", default=False)
    warning: Finding | None = entry(
        "Findings: warnings about the result, where the sentence does; it leads the page",
        default=None,
    )
