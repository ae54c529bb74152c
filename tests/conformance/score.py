"""Run a tool against the cases: right, wrong and said so, or wrong without a word."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum, unique

from conformance import edges, several, single
from conformance.case import Answer, Case, Tool

PARTS: tuple[Callable[[], list[Case]], ...] = (
    single.plain_cases,
    single.curved_cases,
    single.asymptotic_cases,
    single.bent_cases,
    single.broken_cases,
    single.disjoint_cases,
    edges.bound_cases,
    edges.near_bound_cases,
    edges.nuisance_cases,
    edges.cliff_cases,
    several.linear_cases,
    several.structural_cases,
    several.curved_cases,
)
# Words for an end with which a tool takes its number back.
DISOWNED = ("failed", "open_budget")


@unique
class Grade(StrEnum):
    """What an answer is worth."""

    RIGHT = "right"
    FLAGGED = "wrong, and says so"
    SILENT = "wrong, without a word"
    UNSUPPORTED = "cannot be asked"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Graded:
    """The answer to one case and its grade.

    Attributes
    ----------
    case
        The case.
    answer
        The answer; None where the tool broke down or cannot be asked.
    grade
        What it is worth.
    why
        What is wrong with it, empty if nothing.
    """

    case: Case
    answer: Answer | None
    grade: Grade
    why: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConformanceReport:
    """How a tool did.

    Attributes
    ----------
    graded
        One for each case.
    """

    graded: tuple[Graded, ...]

    def count(self, grade: Grade) -> int:
        """How many cases have this grade."""
        return sum(one.grade is grade for one in self.graded)

    @property
    def n_simulations(self) -> int:
        """Evaluations in all."""
        return sum(one.answer.n_simulations for one in self.graded if one.answer is not None)

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """A table: case, grade, simulations, what is wrong."""
        width = max(len(one.case.name) for one in self.graded)
        rows = [
            f"{one.case.name:<{width}}  {one.grade.value:<21}  "
            f"{one.answer.n_simulations if one.answer else 0:>6}  {one.why}".rstrip()
            for one in self.graded
        ]
        counts = ", ".join(f"{self.count(grade)} {grade.value}" for grade in Grade)
        return "\n".join([*rows, f"{len(self.graded)} cases: {counts}"])


def conformance_cases() -> tuple[Case, ...]:
    """All cases, made anew."""
    return tuple(case for part in PARTS for case in part())


def run_conformance(
    tool: Tool, cases: Sequence[Case] | None = None, *, accuracy: float | None = None
) -> ConformanceReport:
    """What a tool answers to the cases, graded.

    An answer is right if it has the intervals of the case, with each closed end as exact as the
    case asks and each open end open, and if those words it has for the ends and for the verdict
    are right. A wrong answer is silent if it comes without a warning and disowns neither end.

    Parameters
    ----------
    tool
        Function from a case to an answer. It raises NotImplementedError for what the tool cannot be
        asked; any other exception counts as wrong and said so.
    cases
        Which to ask; all if None.
    accuracy
        Largest error of an end in place of what each case asks (0.1 % of half the width): 0.05, for
        example, is kind to tools that interpolate.
    """
    asked = conformance_cases() if cases is None else cases
    if accuracy is not None:
        asked = [replace(case, accuracy=accuracy) for case in asked]
    return ConformanceReport(graded=tuple(_graded(case, tool) for case in asked))


def _graded(case: Case, tool: Tool) -> Graded:
    try:
        answer = tool(case)
    except NotImplementedError as error:
        return Graded(case=case, answer=None, grade=Grade.UNSUPPORTED, why=str(error))
    except Exception as error:  # noqa: BLE001 - whatever another program raises
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        return Graded(case=case, answer=None, grade=Grade.FLAGGED, why=why)
    faults = [*_interval_faults(case, answer), *_word_faults(case, answer)]
    grade = Grade.RIGHT
    if faults:
        disowned = answer.lower in DISOWNED or answer.upper in DISOWNED
        grade = Grade.FLAGGED if answer.warnings or disowned else Grade.SILENT
    return Graded(case=case, answer=answer, grade=grade, why="; ".join(faults))


def _interval_faults(case: Case, answer: Answer) -> list[str]:
    if len(answer.intervals) != len(case.intervals):
        return [f"{_text(answer)} instead of {_text(case)}"]
    for found, exact in zip(answer.intervals, case.intervals, strict=True):
        allowed = case.accuracy * case.half_width(exact)
        for one, right in zip(found, exact, strict=True):
            # An open end is right or wrong, not near.
            if one != right and (math.isinf(right) or not abs(one - right) <= allowed):
                return [f"{_text(answer)} instead of {_text(case)}"]
    return []


def _word_faults(case: Case, answer: Answer) -> list[str]:
    wanted = {
        "lower end": (answer.lower, case.lower),
        "upper end": (answer.upper, case.upper),
        "verdict": (answer.verdict, case.verdict),
    }
    return [
        f"{what} {word} instead of {' or '.join(sorted(right))}"
        for what, (word, right) in wanted.items()
        if word is not None and word not in right
    ]


def _text(of: Case | Answer) -> str:
    return " and ".join(f"{_end(low)} to {_end(high)}" for low, high in of.intervals) or "nothing"


def _end(value: float) -> str:
    return "open" if math.isinf(value) else f"{value:.6g}"
