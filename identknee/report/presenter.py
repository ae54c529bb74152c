"""How the report shows answers: tables, and one presenter per class, found by the class's name.

Nothing here imports figures or other verbs, so that a terminal prints an answer at once.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, unique
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from typing_extensions import override

from identknee.laxity.protocol import Protocol
from identknee.runs.declare import Array, declared, entry
from identknee.runs.findings import Finding, doubt_of
from identknee.runs.words import listed
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer

if TYPE_CHECKING:
    from pandas import DataFrame

Cell = str | float | int | None
# Rows that a notebook shows.
MOST_ROWS = 12


@dataclass(frozen=True, slots=True)
class Column:
    """Head of a column.

    Attributes
    ----------
    name
        What stands in it.
    decimals
        Places after the point; None for as many as four significant digits need.
    unit
        Unit of its numbers; empty for text, counts and ratios.
    """

    name: str
    decimals: int | None = 2
    unit: str = ""

    @property
    def head(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with a title.

    Attributes
    ----------
    title
        A line that says what it shows.
    columns
        Heads, as many as every row has cells.
    rows
        Cells: text, numbers, or None where there is nothing to say.
    most
        Rows that a terminal shows, the first ones; all where None.

    Raises
    ------
    ValueError
        If a row is longer or shorter than the heads.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    most: int | None = None

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"every row of {self.title!r} needs {len(self.columns)} cells, got {len(row)}"
                )

    @property
    def name(self) -> str:
        """Its name in files and calls: the words of its title up to the first mark.

        Examples
        --------
        >>> table("95 % intervals of stiffness (3 rows)", ["name"], []).name
        'intervals-of-stiffness'
        """
        return "-".join(re.findall(r"[a-z]+", re.split(r"[:,(]", self.title)[0].lower()))

    def first_rows(self, most: int = MOST_ROWS) -> "Table":
        """The first rows, with how many there are."""
        n = len(self.rows)
        if n <= most:
            return self
        title = f"{self.title} (the first {most} of {n} rows)"
        return Table(title=title, columns=self.columns, rows=self.rows[:most])

    def texts(self) -> list[list[str]]:
        """The cells as text, row by row."""
        return [
            [_text(cell, column) for cell, column in zip(row, self.columns, strict=True)]
            for row in self.rows
        ]

    @property
    def without_blank_columns(self) -> "Table":
        """The table without columns of text, such as remarks, that are blank in every row."""
        n = len(self.columns)
        kept = [i for i in range(n) if i == 0 or any(row[i] != "" for row in self.rows)]
        if len(kept) == n or not self.rows:
            return self
        return replace(
            self,
            columns=tuple(self.columns[i] for i in kept),
            rows=tuple(tuple(row[i] for i in kept) for row in self.rows),
        )

    def markdown(self) -> str:
        """The table as Markdown, its title above it in bold."""
        heads = [column.head for column in self.columns]
        rule = ["---" if self.is_text(i) else "---:" for i in range(len(heads))]
        rows = [[cell.replace("|", "\\|") for cell in row] for row in (heads, *self.texts())]
        lines = ["| " + " | ".join(row) + " |" for row in (rows[0], rule, *rows[1:])]
        return "\n".join([f"**{self.title}**", "", *lines])

    def dataframe(self) -> "DataFrame":
        """The cells as numbers and texts, under heads with units; what is not known is NaN."""
        import pandas as pd

        heads = [column.head for column in self.columns]
        return pd.DataFrame([list(row) for row in self.rows], columns=heads)

    @override
    def __str__(self) -> str:
        """The table in columns of even width, for a terminal."""
        if self.without_blank_columns is not self:
            return str(self.without_blank_columns)
        rows = [[column.head for column in self.columns], *self.texts()[: self.most]]
        widths = [max(len(row[i]) for row in rows) for i in range(len(self.columns))]
        lines = [
            "  ".join(
                cell.ljust(width) if self.is_text(i) else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        left = len(self.rows) + 1 - len(rows)
        more = [f"and {left} more rows, which the report shows"] if left else []
        return "\n".join([self.title, *lines, *more])

    def is_text(self, i: int) -> bool:
        """Whether a column has text, which stands at its left."""
        return i == 0 or any(isinstance(row[i], str) for row in self.rows)


def table(
    title: str,
    heads: Iterable[str | tuple[Any, ...]],
    rows: Iterable[Iterable[Cell]],
    most: int | None = None,
) -> Table:
    """A table; a head is a name, or a name with its decimals and, where it has one, its unit.

    Examples
    --------
    >>> print(table("Ends", ["name", ("force", 1, "N")], [["ACL", 71.25]]))
    Ends
    name  force [N]
    ACL        71.2
    """
    columns = tuple(Column(x) if isinstance(x, str) else Column(*x) for x in heads)
    return Table(title=title, columns=columns, rows=tuple(map(tuple, rows)), most=most)


def is_blank(cell: Cell) -> bool:
    """Whether a cell says nothing, or a number that is not known."""
    return cell is None or (isinstance(cell, float) and math.isnan(cell))


def _text(cell: Cell, column: Column) -> str:
    if cell is None or is_blank(cell):
        return "-"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return str(cell)
    if column.decimals is None:
        return f"{cell:.4g}"
    # Adding zero turns a rounded -0.0 into 0.0.
    return f"{round(cell, column.decimals) + 0.0:.{column.decimals}f}"


if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from identknee.report.laxity_figures import LaxityCurves

# Most trials that are listed by name.
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
    """Parts of the page by the question they answer, in their order; the value is the anchor."""

    KNOWN = "known"
    WRONG = "wrong"
    NEXT = "next"
    LAXITY = "laxity"
    SEARCH = "search"

    @property
    def heading(self) -> str:
        """Heading of the part on the page."""
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
        "The warning that the sentence states, if it is one; it leads the page",
        default=None,
    )


@declared
class Drawing:
    """A figure with what stands below it and what is said in its place."""

    name: str = entry("Name of its file, without an ending")
    figure: "Figure" = entry("The figure")
    caption: str = entry("How to read it")
    description: str = entry("What it shows, for those who do not see it")


# Of a normal distribution, half of its central 95 %.
SDS_95 = 1.96
NOT_CONVERGED = "not converged"
CLOSED, BY_ASSUMPTION = "known", "bounded by assumption"


@unique
class Source(Enum):
    """A method, the most informative first; the value is its name in a sentence."""

    PROFILE = "profile"
    POSTERIOR = "posterior"
    DIAGNOSIS = "diagnosis"
    CAUSE = "diagnosis with the cause"
    INFORMATION = "local approximation"
    EQUIVALENTS = "equivalent set"


@declared
class Range:
    """What one method says of one quantity."""

    source: Source = entry("The method")
    low: float | None = entry("Lower end of its 95 % set or range; None where open")
    high: float | None = entry("Upper end; None where open")
    value: float | None = entry("Its estimate; None where it has none")
    status: str = entry("What is known, in a word or three")
    # A range of another limit is scaled by its root before it is compared.
    reach: float | None = entry(
        "Limit of the squared misfit that it stands for, over the one of a 95 % set; None where "
        "the two cannot be compared",
        default=1.0,
    )

    @property
    def is_closed(self) -> bool:
        """Whether it has both ends."""
        return self.low is not None and self.high is not None

    @property
    def width(self) -> float:
        """From end to end; infinite where one is open."""
        if self.low is None or self.high is None:
            return float("inf")
        return self.high - self.low


def open_ends_text(low: float | None, high: float | None) -> str:
    """Which ends of a range are open.

    Examples
    --------
    >>> open_ends_text(1.0, 2.0), open_ends_text(1.0, None), open_ends_text(None, None)
    ('known', 'open above', 'not known')
    """
    if low is None:
        return "not known" if high is None else "open below"
    return "open above" if high is None else CLOSED


Given = TypeVar("Given", bound=Answer)
# Laxity of all that fits as well: its name, shape ``(n, trial, 5)``, and the quantiles of its ends.
Band = tuple[str, Array, tuple[float, float]]
# The module of `identknee.report.answers` and the presenter there, by the class of the answer.
PRESENTERS = {
    "Demonstration": "demo:DemonstrationPresenter",
    "Simulation": "simulate:SimulationPresenter",
    "Calibration": "fit:CalibrationPresenter",
    "Sweep": "sweep:SweepPresenter",
    "Profiles": "profile:ProfilesPresenter",
    "Sample": "sample:SamplePresenter",
    "LocalIdentifiability": "information:InformationPresenter",
    "Equivalents": "equivalents:EquivalentsPresenter",
    "GlobalSensitivity": "sensitivity:SensitivityPresenter",
    "Diagnosis": "diagnose:DiagnosisPresenter",
    "Isolability": "diagnose:IsolabilityPresenter",
    "Design": "design:DesignPresenter",
    "Comparison": "compare:ComparisonPresenter",
    "SubjectFacts": "subject:SubjectPresenter",
    "ImportedSubject": "subject:ImportedSubjectPresenter",
    "SubjectCheck": "subject:SubjectCheckPresenter",
    "SettledSubject": "subject:SettledSubjectPresenter",
}


class Presenter(Generic[Given]):
    """How answers of one class are shown; methods that are not overridden show nothing.

    Attributes
    ----------
    question
        The part of the page where their figures stand, and what `say` says.
    questions
        Figures that stand elsewhere, by their names.
    is_folded
        Whether all their figures are one click away.
    is_brief
        Whether all that they say is the answer, so that a command prints it all.
    """

    question: ClassVar[Question] = Question.KNOWN
    questions: ClassVar[Mapping[str, Question]] = {}
    is_folded: ClassVar[bool] = False
    is_brief: ClassVar[bool] = False

    def statements(self, answer: Given) -> Iterator[Statement]:
        """What the answer says, its main sentence first."""
        raise NotImplementedError

    def say(self, sentence: str, *tables: Table, is_answer: bool = False) -> Statement:
        """A statement in the part of the page where such answers stand."""
        return Statement(
            question=self.question, sentence=sentence, tables=tables, is_answer=is_answer
        )

    def drawings(self, _answer: Given, _subject: str, _knee: Knee | None) -> Iterator[Drawing]:
        """All figures, the most informative first, with name and knee of the subject if known."""
        yield from ()

    def curves(self, _answer: Given, _beside: Sequence[Answer]) -> "LaxityCurves | None":
        """Measured and simulated laxity, with what other answers say of the same data."""
        return None

    def band(self, _answer: Given) -> Band | None:
        """Laxity of all that fits as well."""
        return None

    def pictures(self, answer: Given, knee: Knee) -> dict[str, "Figure"]:
        """Figures that a command with pictures leaves beside the results, by their files' names."""
        return {x.name: x.figure for x in self.drawings(answer, "", knee)}

    def ranges(self, _answer: Given) -> Iterator[tuple[str, Range]]:
        """Each parameter and force by its name, with what the answer says of it."""
        yield from ()

    def doubt(self, answer: Given, _source: Source) -> str | None:
        """Why values of the answer do not count as known, in words; None where they may."""
        found = doubt_of(answer.findings)
        return None if found is None else found.value

    def next_tests(self, answer: Given) -> Iterator[str]:
        """Advised tests, and what each would bring."""
        for x in self.statements(answer):
            if x.is_answer and x.question is Question.NEXT:
                yield x.sentence

    def headline(self, _answer: Given) -> str:
        """A sentence that leads the page; empty for most answers."""
        return ""

    def protocol(self, _answer: Given) -> Protocol | None:
        """The trials; None if the answer keeps none."""
        return None

    def missing_line(self, _answer: Given, _knee: Knee) -> Array | None:
        """Ends of a missing line of action in the common frame [mm]; None if there is none."""
        return None

    def method(self, _answer: Given) -> Iterator[str]:
        """How it was computed, as sentences for a paper that say no more than its record."""
        yield from ()

    def sources(self, _answer: Given) -> tuple[str, ...]:
        """What a paper that uses the answer should cite for its method."""
        return ()

    def joined(self, _first: Given, _later: Given) -> Given | None:
        """Two answers from the same data merged into one; None if they are shown separately."""
        return None


BOX = "Box (1965), Comput. J. 8(1), 42-52, doi:10.1093/comjnl/8.1.42"


def settings_of(answer: Answer) -> Mapping[str, Any]:
    """The settings of the call that made the answer; none where its record is not known."""
    return {} if answer.record is None else answer.record.settings


def optimizer_sources(method: str) -> tuple[str, ...]:
    """What to cite for an optimizer."""
    return (BOX,) if method == "complex" else ()


def presenter_of(answer: Answer) -> Presenter[Any]:
    """The presenter of an answer."""
    place = PRESENTERS[type(answer).__name__]
    presenter: type[Presenter[Any]] = resolve_name(f"identknee.report.answers.{place}")
    return presenter()


def statements_of(answer: Answer) -> tuple[Statement, ...]:
    """What an answer says, its main sentence first."""
    return tuple(presenter_of(answer).statements(answer))


def main_statements(answer: Answer) -> tuple[Statement, ...]:
    """What belongs at the head of a page; of an answer without it the first statement."""
    said = statements_of(answer)
    return tuple(x for x in said if x.is_answer) or said[:1]


def of_type(answers: Iterable[Answer], kind: type[Given]) -> list[Given]:
    """Those of the answers that are of this class."""
    return [x for x in answers if isinstance(x, kind)]
