"""What an answer says, to a terminal, a notebook or the page: sentences, and the numbers behind."""

from dataclasses import dataclass
from enum import Enum, unique

from identknee.report.tables import Table


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Statement:
    """A sentence for a person, and what it stands on.

    Attributes
    ----------
    question
        What it answers.
    sentence
        One or a few whole sentences.
    tables
        The numbers behind it.
    is_answer
        Whether it leads its part of the page.
    is_warning
        Whether it speaks against the result, and so stands at the head of the page.
    """

    question: Question
    sentence: str
    tables: tuple[Table, ...] = ()
    is_answer: bool = False
    is_warning: bool = False
